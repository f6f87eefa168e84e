"""Transform that owns the command: draws it, resamples it, and grows the grid it is drawn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, NoReturn

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.data import Composite, Unbounded

from torchrl_atr._checks import check_key, check_keys, check_kind, check_whole
from torchrl_atr._inference import keeps_normal_tensors
from torchrl_atr._registry import nearest_entry
from torchrl_atr.envs.transforms.done_keys import flag_key
from torchrl_atr.envs.transforms.grid import CommandGrid
from torchrl_atr.envs.transforms.limits import CommandLimits
from torchrl_atr.envs.transforms.rows import CommandRows
from torchrl_atr.envs.transforms.scores import TRACKING_KEYS, check_scores, read_scores
from torchrl_atr.envs.transforms.seeding import OwnGenerator, make_generator


class CommandCurriculum(OwnGenerator):
    """Grid-adaptive curriculum over (c_v, c_omega) (the paper's "Curriculum Strategy").

    A command is drawn at every reset and again every ``window`` steps, after the reward: the reward of step t
    is for command t, and ``next`` carries command t + 1. A row that is done keeps its command until its
    reset. Over each window the mean of every tracking score, over the fixed window length, is compared with
    its threshold; if all pass and the row did not terminate, the grid around the command's cell grows. An
    episode that ends inside a window therefore scores nothing.

    The transform has its own generator. Over a :class:`~torchrl_atr.envs.RidingEnv`, or several of them in a
    ``SerialEnv`` or ``ParallelEnv``, ``env.set_seed(s)`` restarts it too, and parallel copies get different seeds; over
    another env :meth:`set_seed` does. With ``seed=None`` each instance seeds itself from the operating system; copies
    made with the same ``seed`` draw the same commands. Workers learn together through
    ``collector.map_fn("env.curriculum.load_weights", ...)`` and :meth:`merge_`.

    Only :meth:`pin` fixes a command. A ``command`` in a reset TensorDict is ignored.

    Args:
        tracking_max: The value of each score at perfect tracking (weight times dt).
        tracking_keys: The key of each score in the step's ``next``; leaves of shape ``(*B, 1)``.
        thresholds: Fraction of the maximum that each window mean must reach (gamma_v, gamma_omega).
        window: Steps that a command lasts (5 s at 50 Hz).
        score_from: Steps at the start of each window that are left out of the score.
        grid: The cells and the update rule.
        unscored_key: If given, a bool entry of the reset, ``(*B, 1)``: the first window of rows where it is true is not
            scored, since they started with part of the commanded speeds.
        command_key: The key of the command, ``(*B, 2)``, m/s and rad/s; beside the env's flags where these are nested.
        seed: Seed of the transform's generator.

    Raises:
        ValueError: Lengths differ, a maximum is not positive, the window leaves nothing to score, or a value is of the
            wrong kind.

    Example:
        >>> curriculum = CommandCurriculum(tracking_max=(0.2, 0.1), seed=0)
        >>> curriculum.command_area[0] == 15 / (151 * 21), curriculum.frontier
        (True, (0.5, 0.3))
    """

    weights: Tensor
    _required: Tensor
    rows: CommandRows
    _started: Tensor

    @keeps_normal_tensors
    def __init__(
        self,
        tracking_max: Sequence[float],
        *,
        tracking_keys: Sequence[NestedKey] = TRACKING_KEYS,
        thresholds: Sequence[float] = (0.8, 0.8),
        window: int = 250,
        score_from: int = 0,
        grid: CommandGrid | None = None,
        unscored_key: NestedKey | None = None,
        command_key: NestedKey = "command",
        seed: int | None = None,
    ) -> None:
        check_keys("tracking_keys", tracking_keys, "a list of keys, one per score")
        check_kind("grid", grid, CommandGrid, "a CommandGrid", optional=True)
        check_key("unscored_key", unscored_key, optional=True)
        check_key("command_key", command_key)
        super().__init__(in_keys=list(tracking_keys), out_keys=[command_key])
        tracking_max, thresholds = check_scores(tracking_keys, tracking_max, thresholds)
        window, score_from = check_whole("window", window, None), check_whole("score_from", score_from, None)
        if not 0 <= score_from < window:
            raise ValueError(f"score_from must be in [0, window) = [0, {window}), got {score_from}")
        self.grid = CommandGrid() if grid is None else grid
        self.limits = CommandLimits(self.grid)
        self.window, self.score_from = window, score_from
        self.command_key, self.unscored_key = unravel_key(command_key), unscored_key
        self._generator = make_generator(seed)
        required = torch.tensor(thresholds, dtype=torch.float32) * torch.tensor(tracking_max, dtype=torch.float32)
        self.register_buffer("weights", self.grid.initial_weights())
        self.register_buffer("_required", required * (self.window - self.score_from), persistent=False)
        self.rows = CommandRows()
        self._frontier: tuple[tuple[int, int], tuple[float, float]] | None = None

    @property
    def command(self) -> Tensor:
        """Commands in force (a copy), ``(*B, 2)``, m/s and rad/s.

        Raises:
            RuntimeError: Before the first reset.
        """
        if self.rows.batch is None:
            raise RuntimeError("CommandCurriculum has no commands before the first reset; call env.reset()")
        return self.rows.command.reshape(*self.rows.batch, -1).clone()

    @property
    def command_area(self) -> tuple[float, float]:
        """Sum of weights as a fraction of all cells, and in (m/s)(rad/s)."""
        return self.grid.area(self.weights)

    @property
    def frontier(self) -> tuple[float, float]:
        """Largest ``|c_v|`` (m/s) and ``|c_omega|`` (rad/s) that have a weight now, beyond any limits as well."""
        version = id(self.weights), self.weights._version  # read at every step; the weights seldom change
        if self._frontier is None or self._frontier[0] != version:
            self._frontier = version, self.grid.frontier(self.weights)
        return self._frontier[1]

    def limit(self, bounds: Sequence[float]) -> None:
        """Draw further commands within ``bounds`` alone (:class:`CommandLimits`); those in force last their window."""
        self.limits.part = self.limits.within(bounds)

    @keeps_normal_tensors
    @torch.no_grad()
    def load_weights(self, weights: Tensor) -> None:
        """Replace the grid's weights by ``weights``, ``grid.shape``, in [0, 1].

        Raises:
            ValueError: See :meth:`CommandGrid.validate`.
        """
        self.weights.copy_(self.grid.validate(torch.as_tensor(weights)))

    @keeps_normal_tensors
    @torch.no_grad()
    def merge_(self, other: Tensor) -> None:
        """Merge another worker's weights, ``grid.shape``, by elementwise maximum.

        Raises:
            ValueError: See :meth:`CommandGrid.validate`.
        """
        other = self.grid.validate(torch.as_tensor(other)).to(self.weights)
        self.weights.copy_(self.grid.merge(self.weights, other))

    @keeps_normal_tensors
    @torch.no_grad()
    def pin(self, command: Tensor | Sequence[float], mask: Tensor | None = None) -> None:
        """Fix the command of some rows, through resamples and resets, until :meth:`unpin`.

        It takes effect at the next reset or step. Pinned rows never update the grid.

        Args:
            command: ``(2,)`` for all rows or ``(*B, 2)``, m/s and rad/s, within the grid's bounds; with no negative
                speed where the grid is ``forward_only``.
            mask: bool ``(*B,)`` or ``(*B, 1)``: the rows to pin; all by default.

        Raises:
            RuntimeError: Outside an environment, whose batch size it needs.
            ValueError: Wrong shape, not finite, out of bounds, or backwards where the grid is ``forward_only``.
        """
        self._make_rows()
        self.rows.pin(command, self.grid, mask)

    @keeps_normal_tensors
    @torch.no_grad()
    def unpin(self) -> None:
        """Release all pins. A released row keeps its command, unscored, until its next resample."""
        if self.rows.batch is not None:
            self.rows.pinned = torch.zeros_like(self.rows.pinned)

    @keeps_normal_tensors
    @torch.no_grad()
    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        # before the base env's reset, so that what it emits already holds the new command
        fresh = self._make_rows()
        if tensordict is None:
            tensordict = TensorDict({}, batch_size=self.parent.batch_size, device=self.parent.device)
        rows = self.rows.mask(None if fresh else tensordict.get(flag_key(self, "_reset"), None))
        self.rows.restart(rows)
        self._draw(rows)
        self._started = rows
        return tensordict.set(self.command_key, self.command)

    @keeps_normal_tensors
    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        if self.unscored_key is not None:
            unscored = tensordict_reset.get(self.unscored_key, None)
            if unscored is None:
                hint = nearest_entry(self.unscored_key, tensordict_reset)
                raise KeyError(f"unscored_key {self.unscored_key!r} is not in the reset; {hint}")
            given = unscored.reshape(-1).to(self._started.device, torch.bool)
            self.rows.cells.masked_fill_(self._started & given, -1)
        return tensordict_reset.set(self.command_key, self.command)

    @keeps_normal_tensors
    @torch.no_grad()
    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        command = self.command  # raises before the first reset
        scores, rows = read_scores(self.in_keys, next_tensordict, len(self.rows.elapsed)), self.rows
        elapsed = rows.elapsed.add_(1)
        if self.score_from:
            scores = scores.masked_fill((elapsed <= self.score_from)[:, None], 0)
        rows.sums.add_(scores)
        due = elapsed >= self.window
        if due.any():
            self._close_windows(due, next_tensordict)
            command = self.command
        return next_tensordict.set(self.command_key, command)

    def _call(self, next_tensordict: TensorDictBase) -> NoReturn:
        raise NotImplementedError(
            "CommandCurriculum only works on the reset and step of an environment: "
            "TransformedEnv(env, CommandCurriculum(...)). Remove it from the module or replay buffer."
        )

    forward = _call

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the command, unless the environment already emits it."""
        return self._declare(observation_spec)

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare the command, unless the environment already takes it."""
        return self._declare(state_spec)

    @keeps_normal_tensors
    def clone(self) -> CommandCurriculum:
        """Return a copy without parent, with its own generator, limits and state."""
        other = super().clone()
        other.limits = CommandLimits(self.grid)
        other.limits.part = self.limits.part
        other.weights = self.weights.clone()
        other.rows = CommandRows()
        other.rows.set_extra_state(self.rows.get_extra_state())
        return other

    def get_extra_state(self) -> dict[str, Any]:
        """Return the generator's state, the grid's settings and the limits; weights and rows have their own entries."""
        limits = self.limits.part.bounds
        return {"generator": self._generator.get_state(), "grid": asdict(self.grid), "limits": limits}

    @keeps_normal_tensors
    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`. Rows of another batch size are made anew at the next reset.

        Raises:
            ValueError: The state is of another grid.
        """
        saved = {name: tuple(v) if isinstance(v, list) else v for name, v in state["grid"].items()}
        if saved != asdict(self.grid):
            raise ValueError(f"the saved curriculum has the grid {saved}, this one {asdict(self.grid)}")
        self.limit(state.get("limits", self.grid.bounds))
        self._restore_generator(state["generator"])

    def _declare(self, spec: Composite) -> Composite:
        if self.command_key not in spec.keys(True, True):
            shape = (*spec.shape, len(self.grid.bounds))
            spec[self.command_key] = Unbounded(shape, device=spec.device, dtype=torch.float32)
        return spec

    def _make_rows(self) -> bool:
        """Allocate the rows if there are none for this batch size; return whether it did."""
        if self.parent is None:
            raise RuntimeError("CommandCurriculum is not attached; use TransformedEnv(env, CommandCurriculum(...))")
        batch = self.parent.batch_size
        if self.rows.batch == batch:
            if self.rows.cells.device != self.weights.device:  # after a load from another device
                self.rows.to(self.weights.device)
            return False
        specs = self.parent.full_observation_spec, self.parent.full_state_spec
        dtypes = [spec[self.command_key].dtype for spec in specs if self.command_key in spec.keys(True, True)]
        dtype = dtypes[0] if dtypes else torch.float32
        self.rows.allocate(batch, len(self.grid.bounds), len(self.in_keys), dtype, self.weights.device)
        return True

    def _close_windows(self, due: Tensor, next_tensordict: TensorDictBase) -> None:
        flags = (next_tensordict.get(flag_key(self, name)) for name in ("done", "terminated"))
        done, terminated = (flag.reshape(-1) for flag in flags)
        passed = due & ~terminated & (self.rows.cells >= 0) & (self.rows.sums >= self._required).all(-1)
        if passed.any():
            self.weights.copy_(self.grid.update(self.weights, self.rows.cells[passed]))
        self.rows.restart(due)
        self._draw(due & ~done)

    def _draw(self, rows: Tensor) -> None:
        index = (rows & ~self.rows.pinned).nonzero()[:, 0]
        if len(index):
            # drawn on the CPU: the same commands on every device
            uniforms = torch.rand(len(index), self.grid.uniforms, generator=self._source(), dtype=torch.float64)
            commands, cells = self.limits.sample(self.weights, uniforms.to(self.weights.device))
            self.rows.command.index_copy_(0, index, commands.to(self.rows.command.dtype))
            self.rows.cells.index_copy_(0, index, cells)

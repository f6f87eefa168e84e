"""``QuadrupedEnv``: N robots at a task as one natively batched TorchRL env."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import mujoco
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs import EnvBase

from torchrl_atr._checks import check_kind, check_whole
from torchrl_atr._errors import InputError
from torchrl_atr._inference import keeps_normal_tensors
from torchrl_atr._threads import one_torch_thread_if_small
from torchrl_atr.envs.models import Scene, build_scene
from torchrl_atr.envs.physics import Engine, EngineName, Simulation, make_engine
from torchrl_atr.envs.recorder import FlightRecorder, describe_scene
from torchrl_atr.envs.specs import flag, nested, observation_spec, values
from torchrl_atr.envs.tasks.finite import as_float32, not_finite
from torchrl_atr.envs.tasks.intrinsic_parameters import Randomization
from torchrl_atr.envs.tasks.mirrors import joints, matrix
from torchrl_atr.envs.tasks.reconfiguration import Reconfigurable
from torchrl_atr.envs.tasks.runner import ACTION_LIMIT, EpisodeRunner
from torchrl_atr.envs.tasks.task import Task
from torchrl_atr.envs.tasks.terms import StepOutcome
from torchrl_atr.envs.transforms.seeding import make_generator

_LOGGED = 20
"""Number of failures that are logged and dumped: the first are the most informative, and a disk is finite."""
_LOG = logging.getLogger(__name__)


class QuadrupedEnv(Reconfigurable, EnvBase):
    """Batched env of N quadrupeds at a task, which is read once, at construction.

    Each robot has its own intrinsic parameters, drawn anew at every reset. The env scores with the command it is given
    and echoes it; :class:`~torchrl_atr.envs.transforms.CommandCurriculum` usually draws it. Without a command it is
    zero. Partial resets (``_reset`` mask) touch only the rows they name.

    Args:
        task: what is observed, rewarded, randomised, reset and ended, such as
            :func:`~torchrl_atr.envs.tasks.riding` or your own.
        num_envs: N.
        physics: ``"batch"`` (N robots, all CPUs), ``"dm_control"`` (one robot, the reference), or a ``Simulation``.
        randomization: ``"train"`` or ``"test"`` range of the intrinsic parameters, or ``"off"``.
        num_threads: physics threads; None for the CPUs this process may use.
        failed_episode_replay: share of the failures after which the same robot, with the intrinsics it failed with,
            tries again (for training).
        seed: of intrinsics, initial states, disturbances and sensor errors.
        dump_dir: where the last half second of failed simulations is written, for ``torchrl-atr replay``, if at all.
        compiled: whether ``torch.compile`` makes one function of observations, rewards and terminations. Then making
            the env and its first step take half a minute (seconds, where torch has the result on disk) and the other
            steps less; needs a C++ compiler and Python's headers.

    A simulation that diverges, or an observation or reward that is not finite, ends that robot's episode as terminated,
    with zeros in place of the invalid numbers, and is counted and logged; the other robots are unaffected.

    Raises:
        RobotError: for a robot that cannot do the task as it is described.
        ValueError: for an impossible ``num_envs``, ``physics``, ``randomization``, ``failed_episode_replay`` or
            ``seed``, for ``compiled`` without a compiler, for a term of the task that cannot be used (named), and for
            an action or a command that is misshapen or not finite.
        KeyError: if a step lacks the action.

    Actions are joint displacements in units of the robot's action scale: PD targets q0 + scale · action. Their spec is
    bounded, ±:data:`~torchrl_atr.envs.tasks.runner.ACTION_LIMIT`, for ``rand_action`` and squashed policies such as
    ``TanhNormal(loc, scale, low=spec.low, high=spec.high)``. It does not clip: larger ones, as of Gaussian policies,
    are applied as long as they are finite in float32, up to the joints' control ranges.

    Every step simulates all robots: rows that a rollout leaves out (``_step``, of ``break_when_all_done``) go on.
    An env can be pickled and copied, and continues from there bit for bit. ``set_seed`` fixes intrinsics, initial
    states and disturbances, and the commands of a curriculum in front of it. :meth:`reconfigure` changes parameters.

    Keys, float32 and SI units: ``action`` (N, 12) and ``command`` (N, C) in; out the task's groups of observations (of
    riding ``proprio`` 44, ``speeds`` 2, ``dead_reckoned_velocity`` 3, ``("privileged", "extrinsic")`` 16,
    ``("privileged", "tracking_forecast")`` 14), ``command``, ``observation`` (proprio and command),
    ``("privileged", "intrinsic")``, ``moving_start``, ``("reward_terms", name)``, ``reward`` and the done flags.

    Example:
        >>> from torchrl_atr.envs.tasks import riding
        >>> env = QuadrupedEnv(riding("a1", "single_board"), num_envs=4, seed=0)
        >>> env.rollout(3)["next", "observation"].shape
        torch.Size([4, 3, 46])
    """

    batch_locked = True

    @keeps_normal_tensors
    def __init__(
        self,
        task: Task,
        num_envs: int = 256,
        physics: EngineName | Simulation = "batch",
        randomization: Randomization = "train",
        num_threads: int | None = None,
        failed_episode_replay: float = 0.0,
        seed: int | None = None,
        dump_dir: str | Path | None = None,
        compiled: bool = False,
    ) -> None:
        num_envs = check_whole("num_envs", num_envs, low=1)
        check_kind("dump_dir", dump_dir, (str, Path), "the path of a folder", optional=True)
        check_kind("task", task, Task, "a Task, such as riding('a1', 'single_board')")
        rng = make_generator(seed)  # None: from the operating system, forked workers must not share intrinsics
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([num_envs]))
        self.task, self.rng = task, rng
        self.seeding: tuple[int, int] | None = None  # how often set_seed was called, and its last seed: transforms look
        engine = make_engine(build_scene(task.robot, task.support), task.substep_hook, physics, num_envs, num_threads)
        self.runner = EpisodeRunner(task, engine, randomization, self.rng, failed_episode_replay, compiled)
        self._recorder = None
        if dump_dir is not None:
            self._recorder = FlightRecorder(self.runner, describe_scene(task, self.scene), Path(dump_dir))
        self._emitted = self.runner.observe(self._command(None))
        self._make_specs()

    @property
    def engine(self) -> Engine:
        """Physics engine: simulation state, hook, position in the world."""
        return self.runner.engine

    @property
    def scene(self) -> Scene:
        """Robot, support and their compiled nominal model."""
        return self.runner.scene

    @property
    def model(self) -> mujoco.MjModel:
        """Compiled nominal scene; keyframe 0, ``stand``, is the robot standing in q0."""
        return self.scene.model

    @property
    def num_diverged(self) -> int:
        """Number of failed simulations, observations or rewards so far; each ended the episode of its robot."""
        return self.runner.num_diverged

    @num_diverged.setter
    def num_diverged(self, count: int) -> None:
        self.runner.num_diverged = count

    @property
    def speeds(self) -> Tensor | None:
        """Measured speeds that follow the command, per component, (N, C); None if the task observes no ``speeds``."""
        return self._emitted.get("speeds", None)

    @property
    def followed(self) -> tuple[int, ...]:
        """Indices of the components of the extrinsic state that follow the command; empty where the task names none."""
        followed = self.task.command.followed_by
        names = self.runner.terms.observations.names(("privileged", "extrinsic")) if followed else []
        return tuple(map(names.index, followed))

    @property
    def reflections(self) -> dict[NestedKey, Tensor]:
        """Matrices R, (D, D), by key, that map an entry x to its mirror image R x; the action's too.

        An episode and its mirror image obey the same physics and earn the same reward, up to the order in which a
        solver adds numbers: observing, acting and reflecting commute. R is a signed permutation that undoes itself.

        Raises:
            RobotError, TransporterError: if left and right are no mirror images, in geometry, masses or joints.
            InputError: names a term without a mirror image, or with one of another size.
        """
        observations, command = self.runner.terms.observations, self.task.command
        mirrored = {key: observations.reflection(key, self.scene) for key in observations.groups}
        if command.mirror is None:
            raise InputError(f"the command of task {self.task.name!r} has no mirror image; give it mirror=...")
        mirrored["command"] = matrix(command.mirror, self.scene, len(command), f"the command of {self.task.name!r}")
        mirrored["observation"] = torch.block_diag(mirrored["proprio"], mirrored["command"])
        mirrored["privileged", "intrinsic"] = self.runner.intrinsics.reflection
        return {**mirrored, "action": joints(self.scene)}

    def to(self, device: torch.device | str | int) -> QuadrupedEnv:
        """Return the env itself, on the CPU.

        Raises:
            InputError: for another device.
        """
        if torch.device(device).type != "cpu":
            remedy = f"give the collector env_device='cpu' and policy_device={str(device)!r}"
            raise InputError(f"QuadrupedEnv simulates on the CPU, not on {device}; {remedy}")
        return super().to(device)

    def _make_specs(self) -> None:
        n, terms = self.batch_size[0], self.runner.terms.rewards.terms
        self.observation_spec = observation_spec(self._emitted, terms)
        self.state_spec = Composite(command=values(n, len(self.task.command)), shape=(n,))
        shape = (n, self.runner.joints)
        self.action_spec = Bounded(-ACTION_LIMIT, ACTION_LIMIT, shape, dtype=torch.float32)
        self.reward_spec = values(n, 1)
        flags = {name: flag(n) for name in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(**flags, shape=(n,))

    @keeps_normal_tensors
    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            return
        self.rng.manual_seed(check_whole("seed", seed, high=2**63 - 1))
        self.seeding = (1 if self.seeding is None else self.seeding[0] + 1), int(seed)
        self.runner.failed = torch.zeros_like(self.runner.failed)  # failures before the seed are not replayed

    @keeps_normal_tensors
    @one_torch_thread_if_small
    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        n = self.batch_size[0]
        mask = None if tensordict is None else tensordict.get("_reset", None)
        chosen = torch.ones(n, dtype=torch.bool) if mask is None else mask.reshape(n)
        index = chosen.nonzero().squeeze(-1)
        if len(index):
            fresh = self.runner.start_episodes(index, self._command(tensordict)[index])
            for key, value in fresh.items():
                self._emitted[key] = self._emitted[key].index_copy(0, index, value)
        return self._pack(terminated=torch.zeros(n, dtype=torch.bool))

    @keeps_normal_tensors
    @one_torch_thread_if_small
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        command = self._command(tensordict)
        action = tensordict.get("action", None)
        if action is None:
            raise KeyError("there is no 'action'; run a policy that writes it, or set it, before env.step")
        self.runner.apply_action(action)
        if self._recorder is not None:
            self._recorder.note(action)
        self.engine.advance()
        outcome = self.runner.evaluate_step(command)
        self._report_failed(outcome)
        self._emitted = outcome.observed
        return self._pack(outcome.terminated, outcome.terms, reward=outcome.reward)

    def _report_failed(self, outcome: StepOutcome) -> None:
        """End the episodes of robots that failed, count and log them."""
        for row, reason in self.runner.terminate_failed(outcome).items():
            self.runner.num_diverged += 1
            if self.runner.num_diverged <= _LOGGED:
                hint = "" if self._recorder is None else self._recorder.dump(row, reason)
                _LOG.warning("env id %d: %s, its episode ends%s", row, reason, hint)

    def _command(self, tensordict: TensorDictBase | None) -> Tensor:
        shape = (*self.batch_size, len(self.task.command))
        command = None if tensordict is None else tensordict.get("command", None)
        if command is None:
            return torch.zeros(shape, dtype=torch.float32)
        asked = self.task.command
        return as_float32("command", command, shape, f"({', '.join(asked.names)})", f"give {', '.join(asked.units)}")

    def _pack(self, terminated: Tensor, terms: dict[str, Tensor] | None = None, **more: Tensor) -> TensorDict:
        """Return copies of the last observations, with reward terms (None for zero), flags and ``more``."""
        terminated, names = terminated.unsqueeze(-1), self.runner.terms.rewards.terms
        terms = terms or dict(zip(names, torch.zeros(len(names), *terminated.shape, dtype=torch.float32).unbind()))
        flags = {"terminated": terminated, "truncated": torch.zeros_like(terminated), "done": terminated.clone()}
        observed = {key: value.clone() for key, value in self._emitted.items()}  # theirs to change, also in place
        entries = {**nested(observed), "reward_terms": terms, **flags, **more}
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)

    def get_state(self) -> TensorDict:
        """Return everything :meth:`set_state` needs to continue from here bit for bit, on either engine.

        Disturbances and new episodes draw from ``rng``, whose state is not part of it: ``rng.get_state()``.
        """
        state = {**self.runner.get_state(), "emitted": nested(self._emitted)}
        return TensorDict(state, batch_size=self.batch_size).clone()

    @keeps_normal_tensors
    def set_state(self, state: TensorDictBase) -> None:
        """Restore a state of :meth:`get_state`: intrinsic parameters, simulation state and bookkeeping.

        Without ``emitted``, the last observations, a custom state is observed anew: with the ``command``
        (N, 2) that it may hold, with accelerations of zero and differences to the present state.

        Raises:
            KeyError: if an entry is missing.
            ValueError: if the number of robots or an entry's shape does not fit this env, or a number is not finite.
        """
        if state.batch_size != self.batch_size:
            raise InputError(f"the state is of {tuple(state.batch_size)} robots; this env has {tuple(self.batch_size)}")
        if bad := not_finite({key: value for key, value in state.items(True, True) if value.ndim == 2}):
            row, name = next(iter(bad.items()))
            raise InputError(f"state entry {name!r} is not finite for env id {row}; give a state of get_state()")
        emitted = state.get("emitted", None)
        previous = self.runner.terms.extractor.unrecoverable if emitted is None else ()
        self.runner.set_state(dict(state.exclude("emitted", *previous).items()))
        if emitted is None:
            self._emitted = self.runner.observe(self._command(state))
        else:
            self._emitted = {key: emitted[key].to(value.dtype, copy=True) for key, value in self._emitted.items()}

"""Command tracking of a policy: every command of a grid, several robots each, from rest (Section V-A)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from torchrl_atr._errors import InputError
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.access import achieved_speeds, extrinsic_components
from torchrl_atr.evaluation.envelope import Envelope, envelope_of
from torchrl_atr.evaluation.estimators import EstimationErrors, EstimatorSums
from torchrl_atr.evaluation.ride import MakeEnv, RideStep, key_name, ride_in_chunks
from torchrl_atr.modules.keys import NetworkKeys

Array = NDArray[np.float64]
_TOLERANCE = 1e-9


@dataclass(frozen=True)
class TrackingResult:
    """Figures of each trial; arrays are (V, W, R), for V speeds, W yaw rates and R robots, unless noted.

    Attributes:
        speed_commands: c_v, m/s, (V,).
        yaw_commands: c_ω, rad/s, (W,).
        rms_speed_error: root mean square of v - c_v over the whole trial, or up to the fall, m/s.
        rms_yaw_error: the same of ω - c_ω, rad/s.
        settled_speed_error: mean |v - c_v| after the settling time, m/s; NaN if the robot fell before.
        settled_yaw_error: mean |ω - c_ω|, rad/s.
        settled_speed: mean v after the settling time, m/s.
        settled_yaw_rate: mean ω, rad/s.
        fall_time: seconds until the fall; NaN for a survivor.
        seconds: length of a trial.
        settle: seconds at its start that the settled figures leave out.
        policy_reads: the policy's ``in_keys``: evidence that nothing privileged was among them.
        estimators: errors of the policy's estimates, if it writes any.
        envelope: bounds of the commands that can be followed at all, if known for the task.
    """

    speed_commands: Array
    yaw_commands: Array
    rms_speed_error: Array
    rms_yaw_error: Array
    settled_speed_error: Array
    settled_yaw_error: Array
    settled_speed: Array
    settled_yaw_rate: Array
    fall_time: Array
    seconds: float
    settle: float
    policy_reads: tuple[str, ...] = ()
    estimators: EstimationErrors | None = None
    envelope: Envelope | None = None

    @property
    def survived(self) -> NDArray[np.bool_]:
        """Trials without a fall, (V, W, R)."""
        return np.isnan(self.fall_time)


def command_grid(
    v_max: float = 2.0, w_max: float = 1.0, v_step: float = 1.0, w_step: float = 0.25
) -> tuple[Array, Array]:
    """Return the commands [-v_max, v_max] x [-w_max, w_max]: speeds (V,) in m/s and yaw rates (W,) in rad/s.

    Raises:
        InputError: if a step is not positive or does not divide its range.

    Example:
        >>> speeds, yaw_rates = command_grid()
        >>> speeds.tolist(), len(yaw_rates)
        ([-2.0, -1.0, 0.0, 1.0, 2.0], 9)
    """
    return _axis("speed", v_max, v_step), _axis("yaw rate", w_max, w_step)


def _axis(name: str, limit: float, step: float) -> Array:
    if not (step > 0 and 0 <= limit < math.inf):
        raise InputError(f"the largest {name} {limit:g} must not be negative, nor its step {step:g} be 0 or less")
    cells = round(limit / step)
    if abs(cells * step - limit) > _TOLERANCE * max(1.0, limit):
        raise InputError(f"the {name} step {step:g} must divide the largest {name} {limit:g}; take {limit / 4:g}")
    return np.arange(-cells, cells + 1, dtype=np.float64) * step


def evaluate_tracking(
    policy: TensorDictModuleBase,
    make_env: MakeEnv,
    commands: tuple[ArrayLike, ArrayLike] | None = None,
    robots_per_command: int = 8,
    seconds: float = 10.0,
    settle: float = 5.0,
    seed: int = 0,
    *,
    encoder_module: TensorDictModuleBase | None = None,
    speeds: Callable[[EnvBase], Tensor] = achieved_speeds,
    dt: float = CONTROL_DT,
    keys: NetworkKeys | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> TrackingResult:
    """Ride every command from rest and measure the tracking errors.

    Actions are the distribution's deterministic sample. The policy gets its own ``in_keys`` and nothing else. Each
    robot has its own intrinsic parameters. Nothing is reset: a robot that falls stays down, and its figures end there.

    Args:
        policy: writes the action; it may also write estimates.
        make_env: called as ``make_env(num_envs=n, seed=s)``; should be without pushes.
        commands: speeds (V,) and yaw rates (W,), all pairs of them; :func:`command_grid` by default.
        robots_per_command: R.
        seconds: length of a trial.
        settle: seconds at its start that the settled figures leave out.
        seed: of the first chunk's env; further chunks have the seeds after it.
        encoder_module: reads the env's intrinsic parameters and writes the latent, for the latent estimate's error.
        speeds: measures the achieved speed and yaw rate of an env's robots, (N, 2).
        dt: control period, s.
        keys: names of the TensorDict entries, if the env has its own.
        progress: called with (steps done, steps in total) after every step.

    Returns:
        The figures of all V x W x R trials.

    Raises:
        InputError: for invalid numbers. ValueError: if ``make_env`` built another number of robots.
        TypeError: if the env cannot pin commands, or has no achieved speeds.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> from torchrl_atr.modules import make_networks
        >>> make_env = partial(make_riding_env, "a1", "single_board", pushes=False)
        >>> env = make_env(num_envs=1, seed=0)
        >>> policy = make_networks(env.observation_spec, env.action_spec).deployed_policy()
        >>> evaluate_tracking(policy, make_env, ([0.0, 1.0], [0.0]), 2, 0.1, 0.0).survived.shape
        (2, 1, 2)
    """
    grid = command_grid() if commands is None else commands
    axes = [np.asarray(axis, dtype=np.float64).reshape(-1) for axis in grid]
    total, settled = round(seconds / dt), round(settle / dt)
    if not 0 <= settled < total:
        raise InputError(f"settle={settle} s must be shorter than the trial, seconds={seconds}, and not negative")
    if robots_per_command < 1 or not all(axis.size and np.isfinite(axis).all() for axis in axes):
        raise InputError(
            f"robots_per_command={robots_per_command} and the commands {axes}: give at least one robot per command, "
            "and one finite speed and yaw rate"
        )
    pairs = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    trials = torch.as_tensor(np.repeat(pairs, robots_per_command, axis=0), dtype=torch.float32)
    recorders = ride_in_chunks(
        policy,
        make_env,
        trials.unsqueeze(0),
        total,
        lambda env, commands: _Recorder(env, commands[0], encoder_module, keys or NetworkKeys()),
        seed=seed,
        progress=progress,
        speeds=speeds,
        keys=keys,
    )
    shape = (*(len(axis) for axis in axes), robots_per_command)
    figures = [summarise(r.measured, r.alive, r.commands, dt, settled) for r in recorders]
    joined = {name: np.concatenate([f[name] for f in figures]).reshape(shape) for name in figures[0]}
    return TrackingResult(
        speed_commands=axes[0],
        yaw_commands=axes[1],
        **joined,
        seconds=total * dt,
        settle=settled * dt,
        policy_reads=tuple(key_name(key) for key in policy.in_keys),
        estimators=EstimationErrors.join([r.sums.result() for r in recorders], shape),
        envelope=recorders[0].envelope,
    )


class _Recorder:
    """Recorder of a chunk: commands (n, 2), measured speeds (T, n, 2), and robots that were up (T + 1, n)."""

    def __init__(self, env: EnvBase, commands: Tensor, encoder: TensorDictModuleBase | None, keys: NetworkKeys) -> None:
        self.commands, self.envelope = commands, envelope_of(env)
        self.sums = EstimatorSums(len(commands), encoder, keys, partial(extrinsic_components, env))
        self._measured: list[Tensor] = []
        self._alive = [torch.ones(len(commands), dtype=torch.bool)]

    def __call__(self, step: RideStep) -> None:
        self.sums.add(step.observed, step.decided, step.up)
        self._measured.append(step.speeds)
        self._alive.append(~step.down)

    @property
    def measured(self) -> Array:
        return torch.stack(self._measured).double().numpy()

    @property
    def alive(self) -> NDArray[np.bool_]:
        """Mask of the robots that were up at the start of each step, and at the end in the last row, (T + 1, n)."""
        return torch.stack(self._alive).numpy()


def summarise(
    measured: Array, alive: NDArray[np.bool_], commands: ArrayLike, dt: float, settled: int
) -> dict[str, Array]:
    """Compute the figures of n trials; a trial counts up to and including the step of its fall.

    Args:
        measured: forward speed (m/s) and yaw rate (rad/s) after each step, (T, n, 2).
        alive: mask of the robots that were up at the start of each step, and at the end in the last row, (T + 1, n).
        commands: (n, 2).
        dt: control period, s.
        settled: steps that the settled figures leave out.

    Returns:
        :class:`TrackingResult`'s figures by name, (n,) each.

    Example:
        >>> figures = summarise(np.ones((4, 1, 2)), np.ones((5, 1), bool), [[1.0, 0.5]], 0.02, 2)
        >>> float(figures["rms_speed_error"][0]), float(figures["settled_yaw_error"][0])
        (0.0, 0.5)
    """
    counted, commands = alive[:-1], np.asarray(commands, dtype=np.float64)
    error = measured - commands
    rms = np.sqrt(_mean(error**2, counted))
    absolute = _mean(np.abs(error[settled:]), counted[settled:])
    mean = _mean(measured[settled:], counted[settled:])
    return {
        "rms_speed_error": rms[:, 0],
        "rms_yaw_error": rms[:, 1],
        "settled_speed_error": absolute[:, 0],
        "settled_yaw_error": absolute[:, 1],
        "settled_speed": mean[:, 0],
        "settled_yaw_rate": mean[:, 1],
        "fall_time": np.where(alive[-1], math.nan, counted.sum(0) * dt),
    }


def _mean(values: Array, counted: NDArray[np.bool_]) -> Array:
    """Compute the mean over time of (T, n, 2) where counted (T, n); NaN without counted steps."""
    total = np.where(counted[..., None], values, 0.0).sum(0)
    count = counted.sum(0).astype(np.float64)[:, None]
    return np.divide(total, count, out=np.full_like(total, math.nan), where=count > 0)

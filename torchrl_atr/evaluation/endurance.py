"""Endurance of a policy: minutes of changing commands and pushes, without a reset of robots that fall."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from torchrl_atr._checks import check_number, check_pair, check_whole
from torchrl_atr._errors import InputError
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.access import Component, achieved_speeds, command_limits
from torchrl_atr.evaluation.endurance_log import EnduranceLog
from torchrl_atr.evaluation.ride import MakeEnv, build_env, key_name, ride_in_chunks
from torchrl_atr.modules.keys import NetworkKeys

Array = NDArray[np.float64]
USUAL = (2.0, 1.0)
"""Largest |c_v| (m/s) and |c_ω| (rad/s) unless others are asked for."""
OVERSPEED = (2.0, 2.0)
"""Speed and yaw rate beyond the largest command above which a ride counts as a fall, m/s and rad/s."""


def overspeed_of(margin: Sequence[float]) -> tuple[float, float]:
    """Return the margin beyond the largest command above which a ride counts as a fall: a training's, if it has one.

    Args:
        margin: ``env.overspeed_margin`` of a run, m/s and rad/s, or empty.
    """
    return (margin[0], margin[1]) if margin else OVERSPEED


@dataclass(frozen=True)
class EnduranceResult:
    """Commands, falls and errors of n robots over S seconds and K commands.

    Errors are means over the steps of a second in which the robot was up, NaN without such a step.

    Attributes:
        commands: speeds (m/s) and yaw rates (rad/s), one after the other, (K, n, 2).
        fall_time: seconds until the fall, (n,); NaN for a survivor.
        fall_cause: cause of the fall, (n,): a termination of the task, ``"diverged"``, ``"overspeed"``, or
            ``"terminated"`` where the env does not report one; empty for a survivor.
        since_push: seconds from the last push to the fall, (n,); NaN without one.
        since_command: seconds from the last change of command, or the start, to the fall, (n,); NaN for a survivor.
        up_steps: number of steps of each second in which a robot was up, (S, n).
        settled_steps: number of those steps after the first ``settle`` seconds of a command, (S, n).
        settled_error: mean |v - c_v| (m/s) and |ω - c_ω| (rad/s) over the settled steps, (S, n, 2).
        intrinsics: the intrinsic parameters, scaled so that the training range is [-1, 1], (n, I); I = 0 if the env
            does not emit them.
        intrinsic_names: names of the I intrinsic parameters.
        estimate_error: mean |x̂ - x| of the extrinsic states, (S, n, E); None without estimates.
        components: the E extrinsic states.
        latent_error: mean ‖ẑ - z‖, (S, n); None without an encoder.
        seconds: length of a ride.
        command_seconds: duration of a command.
        settle: seconds at the start of a command that the settled figures leave out.
        bounds: the lowest and the highest command, (2, 2).
        push_seconds: time between two pushes; NaN without pushes.
        overspeed: margin beyond ``bounds`` above which a ride counts as a fall, m/s and rad/s; infinite for no limit.
        dt: control period, s.
        policy_reads: the policy's ``in_keys``.
    """

    commands: Array
    fall_time: Array
    fall_cause: NDArray[np.str_]
    since_push: Array
    since_command: Array
    up_steps: Array
    settled_steps: Array
    settled_error: Array
    intrinsics: Array
    intrinsic_names: tuple[str, ...]
    estimate_error: Array | None
    components: tuple[Component, ...]
    latent_error: Array | None
    seconds: float
    command_seconds: float
    settle: float
    bounds: Array
    push_seconds: float
    overspeed: tuple[float, float]
    dt: float
    policy_reads: tuple[str, ...]

    @property
    def survived(self) -> NDArray[np.bool_]:
        """Robots without a fall, (n,)."""
        return np.isnan(self.fall_time)


def evaluate_endurance(
    policy: TensorDictModuleBase,
    make_env: MakeEnv,
    robots: int = 200,
    seconds: float = 60.0,
    command_seconds: float = 5.0,
    settle: float = 2.0,
    max_speed: float | None = None,
    max_yaw_rate: float | None = None,
    seed: int = 0,
    *,
    overspeed: tuple[float, float] | None = OVERSPEED,
    encoder_module: TensorDictModuleBase | None = None,
    speeds: Callable[[EnvBase], Tensor] = achieved_speeds,
    dt: float = CONTROL_DT,
    keys: NetworkKeys | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> EnduranceResult:
    """Measure survival and tracking errors of rides from rest with a new command every few seconds.

    Each robot has its own commands, uniform within the bounds, and its own intrinsic parameters. Pushes are the env's.
    Actions are the distribution's deterministic sample, and the policy gets its own ``in_keys`` and nothing else.
    Nothing is reset: a robot that falls stays down, and its figures end there.

    Args:
        policy: writes the action; it may also write estimates.
        make_env: called as ``make_env(num_envs=n, seed=s)``; with or without pushes.
        robots: n.
        seconds: length of a ride.
        command_seconds: duration of a command.
        settle: seconds at the start of a command that the settled errors leave out.
        max_speed: largest |c_v|, m/s; 0 for standing still, None for 2, or the env's largest command if that is less.
        max_yaw_rate: largest |c_ω|, rad/s; None for 1, likewise.
        seed: of the commands and the first chunk's env; further chunks have the seeds after it.
        overspeed: margin beyond the largest command, m/s and rad/s, that counts as a fall; None for no limit.
        encoder_module: reads the env's intrinsic parameters and writes the latent, for the latent estimate's error.
        speeds: measures the achieved speed and yaw rate of an env's robots, (N, 2).
        dt: control period, s.
        keys: names of the TensorDict entries, if the env has its own.
        progress: called with (steps done, steps in total) after every step.

    Raises:
        InputError: for invalid numbers, or commands beyond the env's command grid. ValueError: if ``make_env`` built
            another number of robots. TypeError: if the env cannot pin commands, or has no achieved speeds.

    Example:
        >>> from functools import partial
        >>> from torchrl_atr.envs import make_riding_env
        >>> from torchrl_atr.modules import make_networks
        >>> make_env = partial(make_riding_env, "a1", "single_board")
        >>> env = make_env(num_envs=1, seed=0)
        >>> policy = make_networks(env.observation_spec, env.action_spec).deployed_policy()
        >>> evaluate_endurance(policy, make_env, 2, seconds=0.2, command_seconds=0.1, settle=0.0).commands.shape
        (2, 2, 2)
    """
    keys = keys or NetworkKeys()
    robots, seed = check_whole("robots", robots, 1), check_whole("seed", seed)
    check_number("dt", dt, above=0.0)
    total, command_steps, settle_steps = (
        round(check_number(name, value, 0.0) / dt)
        for name, value in (("seconds", seconds), ("command_seconds", command_seconds), ("settle", settle))
    )
    if total < 1 or not settle_steps < command_steps:
        raise InputError(
            f"seconds={seconds} must be at least a control step, {dt} s, and settle={settle} shorter than "
            f"command_seconds={command_seconds}"
        )
    bounds = command_bounds(make_env, max_speed, max_yaw_rate)
    margin = (math.inf, math.inf) if overspeed is None else check_pair("overspeed", overspeed, "two positive numbers")
    commands = draw_commands(bounds, -(-total // command_steps), robots, seed)
    limit = torch.as_tensor(np.abs(bounds).max(0) + margin, dtype=torch.float32)

    def make_log(env: EnvBase, part: Tensor) -> EnduranceLog:
        return EnduranceLog(env, part, total, command_steps, settle_steps, limit, dt, encoder_module, keys)

    logs = ride_in_chunks(
        policy,
        make_env,
        commands,
        total,
        make_log,
        seed=seed,
        progress=progress,
        command_steps=command_steps,
        speeds=speeds,
        keys=keys,
    )
    return EnduranceResult(
        commands=commands.double().numpy(),
        **EnduranceLog.join(logs),
        seconds=total * dt,
        command_seconds=command_steps * dt,
        settle=settle_steps * dt,
        bounds=bounds,
        overspeed=margin,
        dt=dt,
        policy_reads=tuple(key_name(key) for key in policy.in_keys),
    )


def command_bounds(make_env: MakeEnv, max_speed: float | None = None, max_yaw_rate: float | None = None) -> Array:
    """Return the lowest and the highest command, (2, 2).

    Args:
        make_env: called as ``make_env(num_envs=1, seed=0)``.
        max_speed: largest |c_v|, m/s; None for 2, or the env's largest command if that is less.
        max_yaw_rate: largest |c_ω|, rad/s; None for 1, likewise.

    Raises:
        InputError: for commands beyond the env's command grid. TypeError: if the env cannot pin commands.
    """
    env = build_env(make_env, 1, 0)
    _, largest = command_limits(env, (math.inf, math.inf))
    asked = []
    for name, value, most, usual in zip(("max_speed", "max_yaw_rate"), (max_speed, max_yaw_rate), largest, USUAL):
        asked.append(min(usual, most) if value is None else check_number(name, value, 0.0))
        if asked[-1] > most:
            raise InputError(f"{name}={value} is beyond the largest command that the env takes; give up to {most:g}")
    low, high = command_limits(env, (asked[0], asked[1]))
    env.close(raise_if_closed=False)
    return np.stack([low, high])


def draw_commands(bounds: Array, count: int, robots: int, seed: int) -> Tensor:
    """Draw commands, (count, robots, 2), uniform within the bounds."""
    uniform = torch.rand(count, robots, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    low, high = torch.as_tensor(bounds)
    return (low + (high - low) * uniform).float()

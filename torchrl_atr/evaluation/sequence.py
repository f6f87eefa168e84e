"""Rides through a sequence of commands: commanded, achieved and estimated speeds over time (paper, Figure 6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from torchrl_atr._errors import InputError
from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.access import achieved_speeds
from torchrl_atr.evaluation.ride import MakeEnv, RideStep, build_env, ride
from torchrl_atr.evaluation.video import Command, command_at
from torchrl_atr.modules.keys import NetworkKeys

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SequenceResult:
    """Ride of n robots through T control steps; the last axis is speed (m/s) and yaw rate (rad/s).

    Attributes:
        time: of each step's start, s, (T,).
        asked: what the sequence asks for, (T, 2).
        command: what was in force, since commands change at a limited rate, (T, n, 2).
        achieved: after each step, (T, n, 2).
        up: mask of the robots that were up before each step, (T, n) bool.
        estimated: the policy's estimate of the platform's velocity before each step, in the body frame, (T, n, 2);
            None if it estimates none.
        true: what it estimates, (T, n, 2).
    """

    time: Array
    asked: Array
    command: Array
    achieved: Array
    up: NDArray[np.bool_]
    estimated: Array | None
    true: Array | None

    @property
    def survived(self) -> NDArray[np.bool_]:
        """Robots that were up before the last step, (n,)."""
        return self.up[-1]


def evaluate_sequence(
    policy: TensorDictModuleBase,
    make_env: MakeEnv,
    commands: Sequence[Command],
    seconds: float,
    robots: int = 1,
    *,
    seed: int = 0,
    speeds: Callable[[EnvBase], Tensor] = achieved_speeds,
    dt: float = CONTROL_DT,
    keys: NetworkKeys | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SequenceResult:
    """Ride a sequence of commands from rest, without exploration and resets.

    Args:
        policy: writes the action, and possibly an estimate of the extrinsic state.
        make_env: called as ``make_env(num_envs=n, seed=s)``; should be without pushes.
        commands: second, c_v (m/s), c_ω (rad/s), such as :func:`~torchrl_atr.evaluation.command_file.read_commands`
            returns.
        seconds: length of the ride.
        robots: n, each with its own intrinsic parameters.
        seed: of the env.
        speeds: measures the achieved speed and yaw rate of an env's robots, (N, 2).
        dt: control period, s.
        keys: names of the TensorDict entries, if the env has its own.
        progress: called with (steps done, steps in total) after every step.

    Raises:
        InputError: for a ride without a step.
        TypeError: if the env cannot pin commands, or has no achieved speeds.
    """
    steps = round(seconds / dt)
    if steps < 1:
        raise InputError(f"seconds={seconds:g}: a ride lasts {dt:g} s or more")
    time = np.arange(steps, dtype=np.float64) * dt
    asked = torch.tensor([command_at(commands, float(t)) for t in time])
    env = build_env(make_env, robots, seed)
    log = _SequenceLog(env, keys or NetworkKeys(), steps, progress)
    every = asked.unsqueeze(1).expand(-1, robots, -1)
    ride(policy, env, every, steps, log, command_steps=1, speeds=speeds, keys=keys)
    env.close(raise_if_closed=False)
    stacked = {name: torch.stack(values).double().numpy() for name, values in log.values.items() if values}
    return SequenceResult(
        time=time,
        asked=asked.double().numpy(),
        command=stacked["command"],
        achieved=stacked["achieved"],
        up=stacked["up"].astype(bool),
        estimated=stacked.get("estimated"),
        true=stacked.get("true"),
    )


class _SequenceLog:
    """Watch of a ride that keeps every step."""

    def __init__(self, env: EnvBase, keys: NetworkKeys, total: int, progress: Callable[[int, int], None] | None):
        self.env, self.keys, self.total, self.progress = env, keys, total, progress
        self.followed = list(getattr(base_env(env), "followed", ()))
        names = ("command", "achieved", "up", "estimated", "true")
        self.values: dict[str, list[Tensor]] = {name: [] for name in names}

    def __call__(self, step: RideStep) -> None:
        values, keys = self.values, self.keys
        values["command"].append(step.observed.get("command", step.command))
        values["achieved"].append(step.speeds.clone())
        values["up"].append(step.up)
        estimate, truth = step.decided.get(keys.extrinsic_estimate, None), step.observed.get(keys.extrinsic, None)
        if self.followed and estimate is not None and truth is not None:
            values["estimated"].append(estimate[..., self.followed])
            values["true"].append(truth[..., self.followed])
        if self.progress is not None:
            self.progress(step.index + 1, self.total)

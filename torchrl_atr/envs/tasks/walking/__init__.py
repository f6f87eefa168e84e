"""Walking: a quadruped on flat ground follows forward-speed and yaw-rate commands (the legged baseline)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor, cat

from torchrl_atr._checks import check_kind, check_number
from torchrl_atr.envs.interpretation import Interpretation, get_interpretation
from torchrl_atr.envs.models import LEGS, FlatGround, RobotSpec, get_robot
from torchrl_atr.envs.models.robot_file import describe_robot
from torchrl_atr.envs.tasks import mirrors
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.dead_reckoning import KEY, dead_reckoning
from torchrl_atr.envs.tasks.events import Disturbance, Pushes, push_robot, tilted, too_low
from torchrl_atr.envs.tasks.observation_terms import ObservationTerm
from torchrl_atr.envs.tasks.parameters import Gains, gain_arguments, robot_parameters, with_gains
from torchrl_atr.envs.tasks.proprioception import BODY, PROPRIO, SPEEDS
from torchrl_atr.envs.tasks.reward_terms import RewardTerm
from torchrl_atr.envs.tasks.sensors import SensorSet, with_sensors
from torchrl_atr.envs.tasks.task import CommandSpace, Task
from torchrl_atr.envs.tasks.walking.gait import CLOCK_MIRROR, MEMORY, clock
from torchrl_atr.envs.tasks.walking.rewards import WALKING_REWARDS, effort_schedule
from torchrl_atr.envs.tasks.walking.state import WalkingStateExtractor
from torchrl_atr.envs.transforms.grid import CommandGrid

__all__ = ["WALKING_REWARDS", "walking"]

MAX_SPEED = {"G1": 1.5, "G2": 3.0}
"""Largest commanded speed of small and large robots, m/s."""


def walking(
    robot: str | Path | RobotSpec = "a1",
    *,
    profile: str | Interpretation = "default",
    sensors: str | SensorSet = "ideal",
    pushes: bool | Pushes = True,
    gains: Gains | None = None,
    max_speed: float | None = None,
    rewards: Mapping[str, RewardTerm] = WALKING_REWARDS,
) -> Task:
    """Return the walking task: a robot on flat ground follows a forward speed and a yaw rate.

    Args:
        robot: name of a registered robot, path of a ``.toml`` file that describes one, or a spec of your own.
        profile: name of a profile, or :class:`~torchrl_atr.envs.interpretation.Interpretation`.
        sensors: name of a set of sensor errors, ``"ideal"`` or ``"realistic"``, or your own.
        pushes: whether the robot is pushed, every 3 s, or the sizes and interval.
        gains: nominal PD gains, see :data:`~torchrl_atr.envs.tasks.parameters.Gains`; None for the robot's own.
        max_speed: largest commanded speed, m/s; None for 1.5 or, of large robots, 3.
        rewards: the terms of the reward by name.

    Raises:
        UnknownNameError: for an unknown robot or profile.

    Example:
        >>> task = walking("go1")
        >>> task.name, task.command.grid.bounds
        ('walking', (1.5, 1.0))
    """
    pushed = Pushes.of(pushes)
    check_kind("rewards", rewards, Mapping, "a mapping of names to RewardTerm")
    interpretation, walker = get_interpretation(profile), with_gains(get_robot(robot), gains)
    speed = MAX_SPEED[walker.group] if max_speed is None else check_number("max_speed", max_speed, above=0.0)
    bounds = (speed, 1.0)
    grid = CommandGrid(
        bounds, (0.25, 0.25), bounds, (0.25, 0.25), forward_only=True, still=0.1, turning=0.1, straight=0.15
    )
    dead_reckoned, integrated = dead_reckoning("integral")
    arguments: dict[str, Any] = {"robot": describe_robot(robot), **gain_arguments(gains)}
    return Task(
        name="walking",
        robot=walker,
        support=FlatGround(),
        command=CommandSpace(("speed", "yaw_rate"), ("m/s", "rad/s"), grid, mirrors.FORWARD_YAW),
        observations={
            "proprio": {**with_sensors(PROPRIO, sensors), "clock": ObservationTerm(clock, CLOCK_MIRROR)},
            "speeds": SPEEDS,
            KEY: dead_reckoned,
            ("privileged", "extrinsic"): BODY,
            ("privileged", "tracking_forecast"): {
                "errors": ObservationTerm(
                    _errors, (*mirrors.FORWARD_YAW, -1.0, 1.0), unit=("m/s", "rad/s", "m/s", "m")
                ),
                "foot_height": ObservationTerm(_foot_height, mirrors.legs, parts=LEGS, unit="m"),
                "air_time": ObservationTerm(_air_time, mirrors.legs, parts=LEGS, unit="s"),
            },
        },
        rewards=rewards,
        intrinsics=robot_parameters(walker, interpretation),
        terminations={"tilted": tilted, "too_low": too_low},
        disturbances={}
        if pushed is None
        else {"push": Disturbance(partial(push_robot, pushes=pushed), pushed.interval, is_push=True)},
        memory={KEY: integrated, **MEMORY},
        tracking_rewards=("forward_command", "turning_command"),
        state_extractor=WalkingStateExtractor,
        interpretation=interpretation,
        reward_schedule={name: factor for name, factor in effort_schedule().items() if name in rewards},
        arguments=arguments,
    )


def _errors(c: StepContext) -> Tensor:
    """Return errors of speed and yaw rate, lateral speed, height, (N, 4)."""
    state = c.state
    return cat([state.speeds - c.command, state.lateral_speed.unsqueeze(-1), state.height.unsqueeze(-1)], -1)


def _foot_height(c: StepContext) -> Tensor:
    return c.state.foot_height


def _air_time(c: StepContext) -> Tensor:
    return c.memory["air_time"]

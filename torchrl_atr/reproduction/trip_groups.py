"""Policies of Figure 5's trips, and groups of robots that share paths and speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from torchrl_atr._errors import InputError
from torchrl_atr.evaluation.access import command_limits
from torchrl_atr.navigation.trips import footprint_of
from torchrl_atr.reproduction.paper import SPEEDS
from torchrl_atr.reproduction.policies import RiderPolicy
from torchrl_atr.training.loading import commanded_range

SLOWEST = 0.5
"""Least speed of a trip, m/s."""


class Group(NamedTuple):
    """Size class of robots, which follow the same paths.

    Attributes:
        name: of the paper.
        speed: of its trips, m/s.
        footprint: the largest of its methods.
        slowest: name of the policy that takes less than the paper's speed; empty if none does.
    """

    name: str
    speed: float
    footprint: tuple[float, float]
    slowest: str = ""


class Method(NamedTuple):
    """Policy, and what its trips depend on.

    Attributes:
        policy: that rides or walks.
        robot: its name.
        group: size class of the robot, which decides the speed.
        footprint: length and width of what must not touch an obstacle, m.
        fastest, turning: largest speed and yaw rate that it takes, m/s and rad/s.
    """

    policy: RiderPolicy
    robot: str
    group: str
    footprint: tuple[float, float]
    fastest: float = math.inf
    turning: float = math.inf


def method_of(policy: RiderPolicy) -> Method:
    """Return a policy with what its trips depend on.

    Raises:
        InputError: for one that takes less than :data:`SLOWEST`.
    """
    env = policy.envs()(num_envs=1, seed=0)
    env.reset()
    robot = env.base_env.scene.robot
    method = Method(policy, robot.name, robot.group, footprint_of(env))
    limits = [command_limits(env, (math.inf, math.inf))[1].tolist()]
    if (own := commanded_range(policy.config, policy.networks)) is not None:
        limits.append([own.max_speed, own.max_yaw_rate])
    fastest, turning = (min(values) for values in zip(*limits))
    env.close(raise_if_closed=False)
    if fastest < SLOWEST:
        raise InputError(
            f"{policy.name}, {policy.folder}: it takes commands up to {fastest:g} m/s, and trips are at "
            f"{SLOWEST:g} m/s or more; give a policy that takes them, or leave it out"
        )
    return method._replace(fastest=fastest, turning=turning)


def group_of(name: str, methods: Sequence[Method]) -> Group:
    """Return a group of robots: at the paper's speed, or at the largest that all of its methods take."""
    own = [method for method in methods if method.group == name]
    slowest = min(own, key=lambda method: method.fastest)
    speed = min(SPEEDS[name], slowest.fastest)
    length, width = (max(method.footprint[i] for method in own) for i in range(2))
    return Group(name, speed, (length, width), slowest.policy.name if speed < SPEEDS[name] else "")


def speed_text(group: Group) -> str:
    """Return the speed of a group's trips as text, and why it is not the paper's."""
    slower = f" (the paper's {SPEEDS[group.name]:g} are more than {group.slowest} takes)" if group.slowest else ""
    return f"{group.speed:g} m/s in {group.name}{slower}"

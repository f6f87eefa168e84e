"""Reward terms of walking."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np
import torch
from torch import Tensor

from torchrl_atr.envs.tasks.common_rewards import (
    early_termination,
    joint_power,
    speed_tracking,
    undesired_contact,
    yaw_rate_tracking,
)
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.reward_terms import TERMINATION, RewardTerm
from torchrl_atr.envs.tasks.walking.gait import gait, moving


def speed_error(c: StepContext) -> Tensor:
    """Compute |v - c_v|, which has a slope where the kernel has none."""
    return (c.state.speeds[:, 0] - c.command[:, 0]).abs()


def lateral_speed(c: StepContext) -> Tensor:
    """Compute the square of the lateral speed."""
    return c.state.lateral_speed.square()


def vertical_speed(c: StepContext) -> Tensor:
    """Compute the square of the vertical speed."""
    return c.state.velocity[:, 2].square()


def rolling_and_pitching(c: StepContext) -> Tensor:
    """Compute ‖ω_B,xy‖²."""
    return c.state.angular_velocity[:, :2].square().sum(-1)


def orientation(c: StepContext) -> Tensor:
    """Compute ‖θ_B,xy‖²."""
    return c.state.euler[:, :2].square().sum(-1)


def height(c: StepContext) -> Tensor:
    """Compute (h - h_des)²."""
    return (c.state.height - c.robot.standing_height).square()


def joint_torque(c: StepContext) -> Tensor:
    """Compute ‖τ‖²."""
    return c.state.torque.square().sum(-1)


def joint_acceleration(c: StepContext) -> Tensor:
    """Compute ‖q̈‖²."""
    return c.state.joint_acceleration.square().sum(-1)


def action_rate(c: StepContext) -> Tensor:
    """Compute ‖a_t - a_{t-1}‖²."""
    return (c.action - c.previous_action).square().sum(-1)


def abduction(c: StepContext) -> Tensor:
    """Compute ‖q - q0‖² of the abduction joints."""
    return _deviation(c)[:, ::3].square().sum(-1)


def posture(c: StepContext) -> Tensor:
    """Compute ‖q - q0‖²."""
    return _deviation(c).square().sum(-1)


def standing_posture(c: StepContext) -> Tensor:
    """Compute ‖q - q0‖² while the robot is to stand still."""
    return posture(c) * (1.0 - moving(c))


def standing_feet(c: StepContext) -> Tensor:
    """Count feet in the air while the robot is to stand still."""
    return (1.0 - c.state.contacts).sum(-1) * (1.0 - moving(c))


def slip(c: StepContext) -> Tensor:
    """Compute the sum of squared horizontal speeds of feet in contact, Σ c_i ‖v_i,xy‖²."""
    return (c.state.contacts * c.state.foot_velocity[..., :2].square().sum(-1)).sum(-1)


def _deviation(c: StepContext) -> Tensor:
    return c.state.joint_position - torch.tensor(c.robot.q0, dtype=c.action.dtype)


WALKING_REWARDS: Mapping[str, RewardTerm] = MappingProxyType(
    {
        "forward_command": RewardTerm(speed_tracking, 8.0),
        "turning_command": RewardTerm(yaw_rate_tracking, 8.0),
        "speed_error": RewardTerm(speed_error, -4.0),
        "gait": RewardTerm(gait, 8.0),
        "lateral_speed": RewardTerm(lateral_speed, -8.0),
        "vertical_speed": RewardTerm(vertical_speed, -8.0),
        "rolling_and_pitching": RewardTerm(rolling_and_pitching, -0.4),
        "orientation": RewardTerm(orientation, -20.0),
        "height": RewardTerm(height, -200.0),
        "joint_torque": RewardTerm(joint_torque, -1e-3),
        "joint_power": RewardTerm(joint_power, -0.02),
        "joint_acceleration": RewardTerm(joint_acceleration, -1e-6),
        "action_rate": RewardTerm(action_rate, -0.08),
        "abduction": RewardTerm(abduction, -4.0),
        "posture": RewardTerm(posture, -0.4),
        "standing_posture": RewardTerm(standing_posture, -4.0),
        "standing_feet": RewardTerm(standing_feet, -1.0),
        "slip": RewardTerm(slip, -1.6),
        "collision": RewardTerm(undesired_contact, -8.0),
        TERMINATION: RewardTerm(early_termination, -50.0),
    }
)
"""Terms by name, of a robot of an A1's size."""

EFFORT_AT_FIRST: Mapping[str, float] = MappingProxyType(
    {
        "rolling_and_pitching": 0.5,
        "joint_torque": 0.5,
        "joint_power": 0.25,
        "joint_acceleration": 0.5,
        "action_rate": 0.5,
        "slip": 0.5,
    }
)
"""Initial factors of the weights of effort penalties, so that robots do not learn to stand still."""
FULL_EFFORT_AT = 0.5
"""Share of the training after which these factors are 1."""


def effort_schedule() -> dict[str, Callable[[float], float]]:
    """Return the factors of :data:`EFFORT_AT_FIRST` as functions of the progress of training.

    Example:
        >>> float(effort_schedule()["slip"](0.25))
        0.75
    """
    ends = (0.0, FULL_EFFORT_AT)
    return {name: partial(np.interp, xp=ends, fp=(first, 1.0)) for name, first in EFFORT_AT_FIRST.items()}

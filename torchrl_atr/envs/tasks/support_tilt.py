"""Tilt of what a robot stands on, from its legs' angles and its IMU."""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from torchrl_atr.envs.models.leg_kinematics import LegKinematics, leg_kinematics
from torchrl_atr.envs.models.robot import LEGS, RobotSpec
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.observation_terms import ObservationTerm
from torchrl_atr.envs.tasks.rotations import matrix_from_euler, rotate

NAME = "support_tilt"
"""Name of the observation term in ``proprio``."""
PITCH = f"{NAME}[1]"
"""Component that drives a transporter forward, and whose sign steering depends on (Eqs. 1 and 3)."""
_FR, _RR, _FL, _RL = (LEGS.index(leg) for leg in ("FR", "RR", "FL", "RL"))


def feet_tilt(feet: Tensor, orientation: Tensor) -> Tensor:
    """Compute the tilt of the feet's plane against the horizontal.

    Args:
        feet: positions in the trunk's frame, m, (N, 4, 3).
        orientation: roll and pitch of the trunk, rad, (N, 2).

    Returns:
        Roll, pitch and twist, rad, (N, 3): the left side up, the front down, and half the difference of the right and
        the left side's pitch, which steers a transporter of two boards.
    """
    roll, pitch = orientation.unbind(-1)
    level = rotate(matrix_from_euler(roll, pitch, torch.zeros_like(roll)).unsqueeze(-3), feet)
    right, left = level[:, _FR] - level[:, _RR], level[:, _FL] - level[:, _RL]
    across = level[:, _FL] + level[:, _RL] - level[:, _FR] - level[:, _RR]
    pitches = [torch.atan2(-side[:, 2], side[:, 0]) for side in (right, left, right + left)]
    return torch.stack([torch.atan2(across[:, 2], across[:, 1]), pitches[2], (pitches[0] - pitches[1]) / 2.0], -1)


def support_tilt(robot: RobotSpec) -> ObservationTerm:
    """Return the observation term of a robot: :func:`feet_tilt` of what its encoders and its IMU measure, (N, 3).

    A network that reads twelve joint angles finds late how far the board is tilted: a third of a degree, 2 mm at a
    foot, drives it at 0.2 m/s. Feet that are off the board spoil it.

    Raises:
        RobotError: if the robot's MJCF file does not fit its spec.
    """
    compute = partial(_measured, legs=leg_kinematics(robot))
    return ObservationTerm(compute, (-1.0, 1.0, -1.0), parts=("roll", "pitch", "twist"), unit="rad")


def _measured(c: StepContext, legs: LegKinematics) -> Tensor:
    return feet_tilt(legs(c.sensed("joint_position")), c.sensed("orientation"))

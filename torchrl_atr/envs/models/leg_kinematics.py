"""Forward kinematics of a robot's legs in torch, from its MJCF file."""

from __future__ import annotations

import dataclasses
from functools import cache

import mujoco
import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from torchrl_atr.envs.models.feet import find_feet, foot_positions
from torchrl_atr.envs.models.loading import load_robot_model
from torchrl_atr.envs.models.robot import JOINTS_PER_LEG, LEGS, RobotSpec

_OUTWARDS = [[1.0, -1.0, 1.0], [-1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]]
"""Signs of x, y and z of a foot that moves outwards, in the order of :data:`LEGS`."""
_REACHED = 1e-3
"""Tolerance of a foot's position, m."""


class LegKinematics:
    """Positions of the feet in the trunk's frame for given joint angles, by a product of rotations about joint axes.

    Attributes:
        anchors, axes: of the joints where all angles are zero, leg by leg, m and unit vectors, (4, 3, 3).
        feet: positions there, the mean of each foot's geoms, m, (4, 3).

    Args:
        robot: spec of the robot.

    Raises:
        RobotError: if its MJCF file does not fit its spec.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS
        >>> legs = LegKinematics(ROBOTS.get("a1"))
        >>> legs(torch.zeros(2, 12)).shape
        torch.Size([2, 4, 3])
    """

    def __init__(self, robot: RobotSpec) -> None:
        _, model = load_robot_model(robot)
        data = mujoco.MjData(model)
        root = int(model.joint(int(model.body(robot.trunk).jntadr[0])).qposadr[0])
        data.qpos[root : root + 7] = [0, 0, 0, 1, 0, 0, 0]
        joints = [model.joint(name).id for name in robot.joints]
        data.qpos[model.jnt_qposadr[joints]] = 0.0
        mujoco.mj_kinematics(model, data)
        shape = (len(LEGS), JOINTS_PER_LEG, 3)
        self.anchors, self.axes = (_tensor(values[joints]).reshape(shape) for values in (data.xanchor, data.xaxis))
        self.feet = _tensor(foot_positions(data, find_feet(model, robot)))

    def __call__(self, angles: Tensor) -> Tensor:
        """Return the feet's positions in the trunk's frame, m, (N, 4, 3), for joint angles, rad, (N, 12)."""
        angles = angles.unflatten(-1, (len(LEGS), JOINTS_PER_LEG))
        position = self.feet.expand(*angles.shape[:-1], 3)
        for joint in reversed(range(JOINTS_PER_LEG)):  # Rodrigues' formula, from the foot to the trunk
            arm, axis, angle = position - self.anchors[:, joint], self.axes[:, joint], angles[..., joint, None]
            along = axis * (axis * arm).sum(-1, keepdim=True)
            across = torch.linalg.cross(axis.expand_as(arm), arm)
            position = self.anchors[:, joint] + along + torch.cos(angle) * (arm - along) + torch.sin(angle) * across
        return position


@cache
def leg_kinematics(robot: RobotSpec) -> LegKinematics:
    """Return the kinematics of a robot, made once."""
    return LegKinematics(robot)


@cache
def with_stance(robot: RobotSpec, wider: float, longer: float, lower: float) -> RobotSpec:
    """Return a robot that stands with its feet further apart and its trunk lower: another q0 and h_des.

    Args:
        robot: its spec.
        wider: how far each foot moves outwards along y, as a share of the standing height.
        longer: the same along x.
        lower: how far the trunk is lower, likewise.

    Raises:
        RobotError: if the legs do not reach there, or the trunk would be at the height of a fallen robot.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS
        >>> round(with_stance(ROBOTS.get("a1"), 0.15, 0.1, 0.1).standing_height, 3)
        0.252
    """
    if not any((wider, longer, lower)):
        return robot
    legs, unit = leg_kinematics(robot), robot.standing_height
    start = torch.tensor(robot.q0, dtype=torch.float32)
    offset = unit * torch.tensor([longer, wider, lower], dtype=torch.float32)
    target = legs(start) + offset * torch.tensor(_OUTWARDS, dtype=torch.float32)
    found = least_squares(
        lambda angles: (legs(torch.tensor(angles, dtype=torch.float32)) - target).flatten().numpy(), robot.q0
    )
    if np.abs(found.fun).max() > _REACHED:
        raise robot.error(
            f"its legs do not reach a stance {wider:g} wider, {longer:g} longer, {lower:g} lower; give smaller shares"
        )
    q0 = tuple(round(float(angle), 4) for angle in found.x)
    return dataclasses.replace(robot, q0=q0, standing_height=unit * (1.0 - lower))


def _tensor(values: np.ndarray) -> Tensor:
    return torch.tensor(values, dtype=torch.float32)

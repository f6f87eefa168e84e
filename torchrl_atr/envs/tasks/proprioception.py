"""Proprioception of all robots: o_m = [v̇_B, ω_B, θ_xy, q, q̇] and the last action; also contacts and velocity."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrl_atr.envs.models.robot import LEGS
from torchrl_atr.envs.tasks import mirrors
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.observation_terms import Group, ObservationTerm
from torchrl_atr.envs.tasks.rotations import rotate_back
from torchrl_atr.envs.tasks.state import GRAVITY


def body_acceleration(c: StepContext) -> Tensor:
    """Return v̇_B in the body frame, m/s², (N, 3); as specific force if the profile asks for an IMU (A18)."""
    if c.interpretation.gravity_in_acceleration:
        return c.state.body_acceleration + GRAVITY * c.state.rotation[:, 2]
    return c.state.body_acceleration


def angular_velocity(c: StepContext) -> Tensor:
    """Return ω_B in the body frame, rad/s, (N, 3)."""
    return c.state.angular_velocity


def orientation(c: StepContext) -> Tensor:
    """Return roll and pitch θ_xy of the body, rad, (N, 2)."""
    return c.state.euler[:, :2]


def joint_position(c: StepContext) -> Tensor:
    """Return q, rad, (N, 12)."""
    return c.state.joint_position


def joint_velocity(c: StepContext) -> Tensor:
    """Return q̇, rad/s, (N, 12)."""
    return c.state.joint_velocity


def last_action(c: StepContext) -> Tensor:
    """Return the action of this step (a_{t-1} of the next one), as the policy gave it, (N, 12)."""
    return c.action


def contacts(c: StepContext) -> Tensor:
    """Return the contact indicators c_i of the feet, (N, 4)."""
    return c.state.contacts


def body_velocity(c: StepContext) -> Tensor:
    """Return v_B in the body frame, m/s, (N, 3)."""
    return rotate_back(c.state.rotation, c.state.velocity)


PROPRIO: Group = {
    "acceleration": ObservationTerm(body_acceleration, mirrors.POLAR, parts="xyz", unit="m/s²"),
    "angular_velocity": ObservationTerm(angular_velocity, mirrors.AXIAL, parts="xyz", unit="rad/s"),
    "orientation": ObservationTerm(orientation, mirrors.AXIAL[:2], parts=("roll", "pitch"), unit="rad"),
    "joint_position": ObservationTerm(joint_position, mirrors.joints, unit="rad"),
    "joint_velocity": ObservationTerm(joint_velocity, mirrors.joints, unit="rad/s"),
    "action": ObservationTerm(last_action, mirrors.joints, unit="1"),
}
"""o_t without the command, (N, 44): o_m and a_{t-1} by component."""


BODY: Group = {
    "contacts": ObservationTerm(contacts, mirrors.legs, "contact", LEGS, "1"),
    "body_velocity": ObservationTerm(body_velocity, mirrors.POLAR, parts="xyz", unit="m/s"),
}
"""Robot's part of the extrinsic state in any task: c and v_B."""


def speeds(c: StepContext) -> Tensor:
    """Return forward speed, m/s, and yaw rate, rad/s, that follow the command, (N, 2), from the task's state."""
    return c.state.speeds


SPEEDS: Group = {"speeds": ObservationTerm(speeds, mirrors.FORWARD_YAW)}


def heading_frame(euler: Tensor, vector: Tensor) -> Tensor:
    """Return a horizontal vector (N, 2) of the world in the frame that turns with the yaw of ``euler`` (N, 3)."""
    cosine, sine = torch.cos(euler[:, 2]), torch.sin(euler[:, 2])
    x, y = vector[:, 0], vector[:, 1]
    return torch.stack([cosine * x + sine * y, cosine * y - sine * x], -1)

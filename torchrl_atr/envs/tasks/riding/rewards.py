"""Table III: r0 to r17 of riding, each an unweighted function of the state with its weight; r12 is three terms."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

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
from torchrl_atr.envs.tasks.riding.state import RidingState
from torchrl_atr.envs.tasks.state import GRAVITY

FORCE_TOLERANCE = 100.0
"""f_tol, N."""
ROLLING = 0.05
"""Slip speed of a foot's centre over the boards that is not penalised, m/s: a leaning leg rolls its foot this fast.
Such rolling is three quarters of all foot travel while riding."""


def position_alignment(c: StepContext) -> Tensor:
    """Compute r2: ‖p_B,xy - p_P,xy‖, by default with the centre of mass for p_B (A40)."""
    if not c.interpretation.aligned_com:
        return (c.state.position - c.state.platform_position)[:, :2].norm(dim=-1)
    # the centre of mass is that at the start of the last substep: so is P, or a lean ahead by v dt would be rewarded
    platform = c.state.platform_position - c.scene.model.opt.timestep * c.state.platform_velocity
    return (c.state.com - platform)[:, :2].norm(dim=-1)


def heading_alignment(c: StepContext) -> Tensor:
    """Compute r3: |θ_B,z - θ_P,z|."""
    return c.state.relative_yaw[:, 0].abs()


def com_stabilization(c: StepContext) -> Tensor:
    """Compute r4: [CoM outside the foot polygon], of all four feet or of those in contact (A31)."""
    return _outside_feet(c, c.state.com[:, :2])


def zmp_stabilization(c: StepContext) -> Tensor:
    """Compute r5: [ZMP outside the foot polygon]."""
    return _outside_feet(c, zero_moment_point(c.state))


def contact_maintenance(c: StepContext) -> Tensor:
    """Compute r6: (4 - Σ c_i)."""
    return (1.0 - c.state.contacts).sum(-1)


def height_maintenance(c: StepContext) -> Tensor:
    """Compute r7: |(p_B,z - p_P,z) - h_des|; h_des is given above the board's top, p_P is its centre (A35)."""
    desired = c.robot.standing_height + c.scene.support.spec.size[2] / 2
    return (c.state.position[:, 2] - c.state.platform_position[:, 2] - desired).abs()


def transporter_smoothness(c: StepContext) -> Tensor:
    """Compute r8: ‖v̇_P‖ + ‖α_P‖, by default of the drive (Eqs. 1 and 3), else differences of P's velocity (A32).

    The paper penalises abrupt transporter accelerations "slightly" for their inertia effects. P's velocity
    changes in a steady turn too, by v ω: at 2 m/s one more rad/s costs 2 per second, of the 8 that it can earn, and
    robots turn half as fast as commanded. With the board's roll and pitch in α_P the term is -9 per second at an
    action noise of 0.2, against +16 for perfect tracking, and robots learn to end their episodes.
    """
    if c.interpretation.driven_smoothness:
        return c.state.driven_acceleration.abs().sum(-1)
    return c.state.platform_acceleration.norm(dim=-1) + c.state.platform_angular_acceleration.norm(dim=-1)


def body_orientation(c: StepContext) -> Tensor:
    """Compute r9: ‖θ_B,xy‖."""
    return c.state.euler[:, :2].norm(dim=-1)


def body_velocity(c: StepContext) -> Tensor:
    """Compute r10: ‖ω_B,xy‖ + |v_B,z|."""
    return c.state.angular_velocity[:, :2].norm(dim=-1) + c.state.velocity[:, 2].abs()


def action_smoothness(c: StepContext) -> Tensor:
    """Compute r11: ‖a_t - a_{t-1}‖."""
    return (c.action - c.previous_action).norm(dim=-1)


def joint_torque(c: StepContext) -> Tensor:
    """Compute r12, its first part: ‖τ‖."""
    return c.state.torque.norm(dim=-1)


def joint_velocity(c: StepContext) -> Tensor:
    """Compute r12, its second part: ‖q̇‖."""
    return c.state.joint_velocity.norm(dim=-1)


def joint_acceleration(c: StepContext) -> Tensor:
    """Compute r12, its third part: ‖q̈‖."""
    return c.state.joint_acceleration.norm(dim=-1)


def postural_deviation(c: StepContext) -> Tensor:
    """Compute r13: ‖q - q0‖."""
    return (c.state.joint_position - c.action.new_tensor(c.robot.q0)).norm(dim=-1)


def force_regulation(c: StepContext) -> Tensor:
    """Compute r15: Σ max(‖f_i‖ - f_tol, 0)."""
    return (c.state.foot_load - FORCE_TOLERANCE).clamp_min(0.0).sum(-1)


def foot_slip(c: StepContext) -> Tensor:
    """Compute Σ max(‖v_i,xy‖ - 0.05 m/s, 0) of the feet over the boards, a term that Table III lacks."""
    return (c.state.foot_slip - ROLLING).clamp(min=0.0).sum(-1)


_AROUND = torch.tensor([0, 2, 3, 1])
"""FR, FL, RL, RR: counter-clockwise seen from above."""


def _outside_feet(c: StepContext, point: Tensor) -> Tensor:
    contacts = c.state.contacts > 0 if c.interpretation.contacting_polygon else None
    return outside_polygon(point, c.state.foot_position[..., :2], contacts)


def outside_polygon(point: Tensor, feet: Tensor, contacts: Tensor | None = None) -> Tensor:
    """Return whether a point lies outside the polygon of the feet.

    Args:
        point: (N, 2).
        feet: (N, 4, 2) in the order FR, RR, FL, RL.
        contacts: which of them are corners, (N, 4) bool; all by default. Fewer than three span nothing.

    Returns:
        (N,) 0 or 1.
    """
    corners = feet.index_select(1, _AROUND)
    if contacts is not None:  # a lifted foot is moved onto the next: its edge becomes a point
        lifted = ~contacts.index_select(1, _AROUND).unsqueeze(-1)
        corners = torch.where(lifted, corners.roll(-1, dims=1), corners)
    edges = corners.roll(-1, dims=1) - corners
    to_point = point.unsqueeze(1) - corners
    cross = edges[..., 0] * to_point[..., 1] - edges[..., 1] * to_point[..., 0]
    outside = (cross < 0.0).any(-1)
    if contacts is not None:
        outside = outside | (contacts.sum(-1) < 3)
    return outside.to(point.dtype)


def zero_moment_point(state: RidingState) -> Tensor:
    """Compute the ZMP on the plane of the feet, m, (N, 2).

    It is that of a point mass at the centre of mass that accelerates as the trunk does in the world frame (A31).
    """
    height = state.com[:, 2] - state.foot_position[..., 2].mean(-1)
    vertical = (state.acceleration[:, 2] + GRAVITY).clamp_min(0.1 * GRAVITY)
    return state.com[:, :2] - (height / vertical).unsqueeze(-1) * state.acceleration[:, :2]


RIDING_REWARDS: Mapping[str, RewardTerm] = MappingProxyType(
    {
        "forward_command": RewardTerm(speed_tracking, 8.0, "r0"),
        "steering_command": RewardTerm(yaw_rate_tracking, 8.0, "r1"),
        "position_alignment": RewardTerm(position_alignment, -30.0, "r2"),
        "heading_alignment": RewardTerm(heading_alignment, -4.0, "r3"),
        "com_stabilization": RewardTerm(com_stabilization, -1.0, "r4"),
        "zmp_stabilization": RewardTerm(zmp_stabilization, -1.0, "r5"),
        "contact_maintenance": RewardTerm(contact_maintenance, -2.0, "r6"),
        "height_maintenance": RewardTerm(height_maintenance, -1.0, "r7"),
        "transporter_smoothness": RewardTerm(transporter_smoothness, -1.0, "r8"),
        "body_orientation": RewardTerm(body_orientation, -0.9, "r9"),
        "body_velocity": RewardTerm(body_velocity, -1e-3, "r10"),
        "action_smoothness": RewardTerm(action_smoothness, -1e-5, "r11"),
        "joint_torque": RewardTerm(joint_torque, -1e-4, "r12"),
        "joint_velocity": RewardTerm(joint_velocity, -1e-4, "r12"),
        "joint_acceleration": RewardTerm(joint_acceleration, -1e-7, "r12"),
        "postural_deviation": RewardTerm(postural_deviation, -1e-2, "r13"),
        "energy_efficiency": RewardTerm(joint_power, -1e-4, "r14"),
        "force_regulation": RewardTerm(force_regulation, -1e-2, "r15"),
        "collision_avoidance": RewardTerm(undesired_contact, -10.0, "r16"),
        TERMINATION: RewardTerm(early_termination, -10.0, "r17"),
    }
)
"""Table III by name, 20 weighted terms k0 ... k19, the minus of r2 and r3 that is missing in print included (A8)."""

STEADY: Mapping[str, float] = MappingProxyType(
    {"height_maintenance": 10.0, "body_orientation": 5.0, "body_velocity": 500.0, "postural_deviation": 20.0}
)
"""Factors of r7, r9, r10 and r13 with which a robot learns to ride without swaying and to keep its feet below it."""

"""Table III: eighteen named reward terms with the paper's weights, each a function of the riding state.

Adding a term is one :func:`reward_term` entry; the env's specs, logs and tests follow from
:data:`REWARD_TERMS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.profiles import Readings
from torchrl_atr.envs.task.state import CONTACT_THRESHOLD, CONTROL_DT, GRAVITY, RidingState

KERNEL_WIDTH = 0.5
"""Width of the tracking kernels r0 and r1, m/s and rad/s."""
FORCE_TOLERANCE = 100.0
"""f_tol, N."""


@dataclass
class RewardContext:
    """What a term may look at.

    Attributes:
        state: N robots after the step.
        command: (c_v, c_ω) in force during the step, (N, 2).
        action: a_t, (N, 12).
        previous_action: a_{t-1}, (N, 12).
        terminated: early terminations, (N,) bool.
        robot: q0 and h_des.
        deck_thickness: m.
        readings: the paper's open points.
    """

    state: RidingState
    command: Tensor
    action: Tensor
    previous_action: Tensor
    terminated: Tensor
    robot: RobotSpec
    deck_thickness: float
    readings: Readings = field(default_factory=Readings)


Term = Callable[[RewardContext], Tensor]
REWARD_TERMS: dict[str, Term] = {}
"""r0 ... r17 by name, in the paper's order: from a :class:`RewardContext` to (N,), weights included."""


def reward_term(name: str) -> Callable[[Term], Term]:
    """Registers a term under ``name``.

    Raises:
        ValueError: if the name is taken.
    """

    def register(term: Term) -> Term:
        if name in REWARD_TERMS:
            raise ValueError(f"the reward term {name!r} is registered already")
        REWARD_TERMS[name] = term
        return term

    return register


def tracking_kernel(error: Tensor) -> Tensor:
    """exp(-|e| / 0.5): 1 for perfect tracking, any shape (of r0 and r1)."""
    return torch.exp(-error.abs() / KERNEL_WIDTH)


MAX_TRACKING = {"forward_command": 8.0, "steering_command": 8.0}
"""k0 and k1: the two terms at perfect tracking; the curriculum's thresholds are fractions of them."""


@reward_term("forward_command")
def forward_command(c: RewardContext) -> Tensor:
    """r0 = k0 exp(-|v_P,x - c_v| / 0.5), with v in P_planar (the printed p is read as v, A7)."""
    return MAX_TRACKING["forward_command"] * tracking_kernel(c.state.speeds[:, 0] - c.command[:, 0])


@reward_term("steering_command")
def steering_command(c: RewardContext) -> Tensor:
    """r1 = k1 exp(-|ω_P,z - c_ω| / 0.5)."""
    return MAX_TRACKING["steering_command"] * tracking_kernel(c.state.speeds[:, 1] - c.command[:, 1])


@reward_term("position_alignment")
def position_alignment(c: RewardContext) -> Tensor:
    """r2 = -k2 ‖p_B,xy - p_P,xy‖ (the minus is missing in print, A8)."""
    return -30.0 * (c.state.position - c.state.platform_position)[:, :2].norm(dim=-1)


@reward_term("heading_alignment")
def heading_alignment(c: RewardContext) -> Tensor:
    """r3 = -k3 |θ_B,z - θ_P,z| (the minus is missing in print, A8)."""
    return -4.0 * c.state.relative_yaw[:, 0].abs()


@reward_term("com_stabilization")
def com_stabilization(c: RewardContext) -> Tensor:
    """r4 = -k4 [CoM outside the foot polygon], of all four feet or of those in contact (A31)."""
    return -1.0 * _outside_feet(c, c.state.com[:, :2])


@reward_term("zmp_stabilization")
def zmp_stabilization(c: RewardContext) -> Tensor:
    """r5 = -k5 [ZMP outside the foot polygon]."""
    return -1.0 * _outside_feet(c, zero_moment_point(c.state))


@reward_term("contact_maintenance")
def contact_maintenance(c: RewardContext) -> Tensor:
    """r6 = -k6 (4 - Σ c_i)."""
    return -2.0 * (1.0 - c.state.contacts).sum(-1)


@reward_term("height_maintenance")
def height_maintenance(c: RewardContext) -> Tensor:
    """r7 = -k7 |(p_B,z - p_P,z) - h_des|; h_des is given above the deck's top, p_P is its centre (A35)."""
    desired = c.robot.standing_height + c.deck_thickness / 2
    return -1.0 * (c.state.position[:, 2] - c.state.platform_position[:, 2] - desired).abs()


@reward_term("transporter_smoothness")
def transporter_smoothness(c: RewardContext) -> Tensor:
    """r8 = -k8 (‖v̇_P‖ + ‖α_P‖): by default what the drive gives (Eqs. 1 and 3), else differences of P's velocity (A32).

    The text wants abrupt transporter accelerations "slightly" penalised for their inertia effects. P's velocity
    changes in a steady turn too, by v ω: at 2 m/s one rad/s more costs 2 a second, of the 8 that it can earn, and
    riders turn half as fast as they are told to. With the deck's roll and pitch in α_P the term is -9 a second at an
    action noise of 0.2, against +16 for perfect tracking, and robots learn to end their episodes.
    """
    if c.readings.driven_smoothness:
        return -1.0 * c.state.driven_acceleration.abs().sum(-1)
    return -1.0 * (c.state.platform_acceleration.norm(dim=-1) + c.state.platform_angular_acceleration.norm(dim=-1))


@reward_term("body_orientation")
def body_orientation(c: RewardContext) -> Tensor:
    """r9 = -k9 ‖θ_B,xy‖."""
    return -0.9 * c.state.euler[:, :2].norm(dim=-1)


@reward_term("body_velocity")
def body_velocity(c: RewardContext) -> Tensor:
    """r10 = -k10 (‖ω_B,xy‖ + |v_B,z|)."""
    return -1e-3 * (c.state.angular_velocity[:, :2].norm(dim=-1) + c.state.velocity[:, 2].abs())


@reward_term("action_smoothness")
def action_smoothness(c: RewardContext) -> Tensor:
    """r11 = -k11 ‖a_t - a_{t-1}‖."""
    return -1e-5 * (c.action - c.previous_action).norm(dim=-1)


@reward_term("joint_smoothness")
def joint_smoothness(c: RewardContext) -> Tensor:
    """r12 = -k12 ‖τ‖ - k13 ‖q̇‖ - k14 ‖q̈‖."""
    state = c.state
    torque, velocity = state.torque.norm(dim=-1), state.joint_velocity.norm(dim=-1)
    return -1e-4 * torque - 1e-4 * velocity - 1e-7 * state.joint_acceleration.norm(dim=-1)


@reward_term("postural_deviation")
def postural_deviation(c: RewardContext) -> Tensor:
    """r13 = -k15 ‖q - q0‖."""
    return -1e-2 * (c.state.joint_position - c.action.new_tensor(c.robot.q0)).norm(dim=-1)


@reward_term("energy_efficiency")
def energy_efficiency(c: RewardContext) -> Tensor:
    """r14 = -k16 Σ max(τ_j q̇_j, 0), both of the same instant."""
    return -1e-4 * (c.state.torque * c.state.torque_velocity).clamp_min(0.0).sum(-1)


@reward_term("force_regulation")
def force_regulation(c: RewardContext) -> Tensor:
    """r15 = -k17 Σ max(‖f_i‖ - f_tol, 0)."""
    return -1e-2 * (c.state.foot_load - FORCE_TOLERANCE).clamp_min(0.0).sum(-1)


@reward_term("collision_avoidance")
def collision_avoidance(c: RewardContext) -> Tensor:
    """r16 = -k18 [something other than a foot touches the deck]."""
    return -10.0 * (c.state.other_force.norm(dim=-1) > CONTACT_THRESHOLD).to(c.action.dtype)


TERMINATION = -10.0
"""-k19: what an early termination costs."""


@reward_term("termination")
def termination(c: RewardContext) -> Tensor:
    """r17 = -k19 [early termination]."""
    return TERMINATION * c.terminated.to(c.action.dtype)


_AROUND = torch.tensor([0, 2, 3, 1])
"""FR, FL, RL, RR: counter-clockwise seen from above."""


def _outside_feet(c: RewardContext, point: Tensor) -> Tensor:
    contacts = c.state.contacts > 0 if c.readings.contacting_polygon else None
    return outside_polygon(point, c.state.foot_position[..., :2], contacts)


def outside_polygon(point: Tensor, feet: Tensor, contacts: Tensor | None = None) -> Tensor:
    """Whether a point lies outside the polygon of the feet.

    Args:
        point: (N, 2).
        feet: (N, 4, 2) in the order FR, RR, FL, RL.
        contacts: which of them are corners, (N, 4) bool; all by default. Fewer than three span nothing.

    Returns:
        (N,) 0 or 1.
    """
    corners = feet.index_select(1, _AROUND)
    if contacts is not None:  # one lifted foot moves onto the next: its edge shrinks to a point
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
    """ZMP on the plane of the feet from the body's acceleration, the platform's included (A31), m, (N, 2)."""
    height = state.com[:, 2] - state.foot_position[..., 2].mean(-1)
    vertical = (state.acceleration[:, 2] + GRAVITY).clamp_min(0.1 * GRAVITY)
    return state.com[:, :2] - (height / vertical).unsqueeze(-1) * state.acceleration[:, :2]


def reward_scale(readings: Readings) -> float:
    """What every reward is multiplied by: the control period, or 1 (A16)."""
    return CONTROL_DT if readings.rewards_times_dt else 1.0


def compute_rewards(context: RewardContext, *, scale: float, clip_to_positive: bool) -> tuple[Tensor, Tensor]:
    """All terms and their sum.

    Args:
        context: what happened.
        scale: from :func:`reward_scale`.
        clip_to_positive: reading A17: what is below zero is cut, then termination is added.

    Returns:
        ``reward`` (N, 1) and the scaled terms, (18, N, 1) in the order of :data:`REWARD_TERMS`; they add up to
        ``reward`` unless clipped.
    """
    terms = scale * torch.stack([term(context) for term in REWARD_TERMS.values()]).unsqueeze(-1)
    total = terms.sum(0)
    if clip_to_positive:
        ended = terms[list(REWARD_TERMS).index("termination")]
        total = (total - ended).clamp_min(0.0) + ended
    return total, terms

"""Rewards that several tasks have: the tracking kernel of r0 and r1, energy, collisions and early terminations."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.state import CONTACT_THRESHOLD

KERNEL_WIDTH = 0.5
"""Width of the tracking kernels, m/s and rad/s."""


def tracking_kernel(error: Tensor, width: float = KERNEL_WIDTH) -> Tensor:
    """Compute exp(-|e| / width): 1 for perfect tracking, any shape.

    Example:
        >>> round(float(tracking_kernel(torch.tensor(-0.5))), 3)
        0.368
    """
    return torch.exp(-error.abs() / width)


def speed_tracking(c: StepContext) -> Tensor:
    """Compute r0: exp(-|v - c_v| / 0.5), with v in P_planar for a transporter (the printed p is read as v, A7)."""
    return tracking_kernel(c.state.speeds[:, 0] - c.command[:, 0])


def yaw_rate_tracking(c: StepContext) -> Tensor:
    """Compute r1: exp(-|ω - c_ω| / 0.5)."""
    return tracking_kernel(c.state.speeds[:, 1] - c.command[:, 1])


def joint_power(c: StepContext) -> Tensor:
    """Compute r14: Σ max(τ_j q̇_j, 0), both of the same instant."""
    return (c.state.torque * c.state.torque_velocity).clamp_min(0.0).sum(-1)


def undesired_contact(c: StepContext) -> Tensor:
    """Compute r16: [something other than a foot touches the boards or the ground]."""
    return (c.state.other_force.norm(dim=-1) > CONTACT_THRESHOLD).to(c.action.dtype)


def early_termination(c: StepContext) -> Tensor:
    """Compute r17: [early termination]."""
    return c.terminated.to(c.action.dtype)

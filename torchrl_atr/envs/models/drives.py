"""Propulsion of a transporter by tilt, Eqs. 1, 3 and 7, which a custom design may replace."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchrl_atr.envs.interpretation import Interpretation

if TYPE_CHECKING:
    from torchrl_atr.envs.models.transporter import TransporterSpec

Drive = Callable[[Tensor, Tensor, "TransporterSpec", Interpretation], Tensor]
"""Function of tilt (N, 2), speeds (N, 2), transporter and interpretation; returns the propulsion (N, 2), float64."""


def tilt_drive(tilt: Tensor, speeds: Tensor, transporter: TransporterSpec, interpretation: Interpretation) -> Tensor:
    """Compute the propulsion of Eqs. 1 and 3 (or 7 and 8) before resistance, for a transporter of unit relative mass.

    Args:
        tilt: forward tilt θ_y (or θ_avg) and steering tilt θ_x (or θ_dif), rad, (N, 2).
        speeds: v_f, m/s, and ω_z, rad/s, (N, 2); not used.
        transporter: its drive limits.
        interpretation: ``steering_smoothing`` (A11).

    Returns:
        Forward drive v̇max clip(θ_y/θnp), m/s², and yaw drive αmax sgn(θ_y) clip(-θ_x/θnp), rad/s², with sgn(0) = 1 as
        the paper says, (N, 2).

    Example:
        >>> from torchrl_atr.envs.models import TRANSPORTERS
        >>> board = TRANSPORTERS.get("single_board_g1")
        >>> tilt = torch.tensor([[0.39, 0.0]], dtype=torch.float64)
        >>> tilt_drive(tilt, torch.zeros_like(tilt), board, Interpretation())[0, 0].item()
        6.0
    """
    smoothing = interpretation.steering_smoothing
    forward = tilt[..., 0]
    sign = torch.tanh(forward / smoothing) if smoothing else torch.copysign(_ONE, forward + 0.0)  # sgn(-0) = 1, too
    pushes = (tilt / transporter.tilt_norm).clamp_(-1.0, 1.0)
    pushes *= _limits(transporter.max_acceleration, -transporter.max_yaw_acceleration)
    pushes[..., 1].mul_(sign)
    return pushes


_ONE = torch.ones((), dtype=torch.float64)


@cache
def _limits(forward: float, yaw: float) -> Tensor:
    return torch.tensor([forward, yaw], dtype=torch.float64)

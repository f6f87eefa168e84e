"""What the critic sees besides the state: where the tilt of this moment leads, measured as the reward measures it."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.mirrors import FORWARD_YAW
from torchrl_atr.envs.tasks.tracking import tracking_kernel

HORIZONS = (0.0, 0.5, 1.0, 2.0)
"""Seconds ahead at which the tracking kernels are evaluated."""


FORECAST_MIRROR = (-1.0, 1.0, *FORWARD_YAW, *FORWARD_YAW, *(1.0, 1.0) * len(HORIZONS))
"""Signs of the forecast's components: tilts, accelerations, errors, kernels."""


def tracking_forecast(c: StepContext) -> Tensor:
    """Compute driving tilts, driven accelerations, tracking errors and the tracking kernels a few moments ahead.

    A lean pays seconds later, through the tilt it causes, and the yaw drive is a product: sgn(θ_y) clip(-θ_x). A value
    function that has to find this in joint angles credits a lean late and through much noise; told outright, the
    advantage of a lean is seen at once. Only the critic reads it, and the critic is not deployed.

    Args:
        c: its command is (c_v, c_ω), (N, 2).

    Returns:
        (N, 14): steering and forward tilt, rad; driven v̇ and α; speed errors; exp(-|e|/0.5) of both at each of
        :data:`HORIZONS` if the accelerations lasted.
    """
    state = c.state
    error = state.speeds - c.command
    seconds = error.new_tensor(HORIZONS).unsqueeze(-1)  # (4, 1)
    ahead = tracking_kernel(error.unsqueeze(-2) + seconds * state.driven_acceleration.unsqueeze(-2)).flatten(-2)
    forward, steering = state.driving_tilt.split(1, -1)
    return torch.cat([steering, forward, state.driven_acceleration, error, ahead], -1)

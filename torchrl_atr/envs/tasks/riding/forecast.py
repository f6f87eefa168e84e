"""Additional critic input: tracking rewards that the present tilt leads to if it lasts."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrl_atr.envs.tasks.common_rewards import tracking_kernel
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.mirrors import FORWARD_YAW

HORIZONS = (0.0, 0.5, 1.0, 2.0)
"""Horizons, s, at which the tracking kernels are evaluated."""


FORECAST_MIRROR = (-1.0, 1.0, *FORWARD_YAW, *FORWARD_YAW, *(1.0, 1.0) * len(HORIZONS))
"""Signs of the forecast's components: tilts, accelerations, errors, kernels."""


def tracking_forecast(c: StepContext) -> Tensor:
    """Compute driving tilts, driven accelerations, tracking errors and the tracking kernels a few moments ahead.

    The reward of a lean comes seconds later, through the tilt it causes, and the yaw drive is a product:
    sgn(θ_y) clip(-θ_x). A value function that must infer this from joint angles assigns credit late and with much
    noise; given as an input, the advantage of a lean is immediate. Only the critic reads it; it is not deployed.

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

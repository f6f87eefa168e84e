"""When an episode ends early (A34): the robot risks flipping, or falling off or onto the transporter."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.profiles import Readings
from torchrl_atr.envs.task.state import RidingState


def fallen(state: RidingState, scene: Scene, readings: Readings) -> Tensor:
    """Robots whose episode ends now.

    Args:
        state: N robots.
        scene: deck size and the robot's lowest height.
        readings: ``tilt_limit``.

    Returns:
        (N,) bool: body roll or pitch beyond the limit, body centre beyond the deck, or body too low over the
        deck's top.
    """
    length, width, thickness = scene.transporter.size
    tilted = (state.euler[:, :2].abs() > readings.tilt_limit).any(-1)
    off_deck = (state.relative_position.abs() > state.position.new_tensor([length / 2, width / 2])).any(-1)
    height = state.position[:, 2] - state.platform_position[:, 2] - thickness / 2
    finite = torch.isfinite(state.position.sum(-1) + state.joint_velocity.sum(-1))
    return tilted | off_deck | (height < scene.robot.min_height) | ~finite

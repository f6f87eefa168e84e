"""State of walking: that of the robot, and of its gait."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import torch
from torch import Tensor

from torchrl_atr.envs.models.scene import STAND
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.tasks.proprioception import heading_frame
from torchrl_atr.envs.tasks.state import QuadrupedState, Rows, SimulationSnapshot, StateExtractor, single


@dataclass
class WalkingState(QuadrupedState):
    """State of a robot and its gait, float32.

    Attributes:
        speeds: forward speed in the frame that turns with the body's yaw, m/s, and yaw rate, rad/s, (N, 2).
        lateral_speed: to the left in that frame, m/s, (N,).
        height: of the body's origin above the ground, m, (N,).
        foot_height: of the feet above their height in the standing pose, m, (N, 4).
        foot_velocity: of the feet over the last control step, world frame, m/s, (N, 4, 3).
    """

    speeds: Tensor
    lateral_speed: Tensor
    height: Tensor
    foot_height: Tensor
    foot_velocity: Tensor


class WalkingStateExtractor(StateExtractor):
    """Extractor of a :class:`WalkingState` from an engine."""

    state_type = WalkingState

    def __init__(self, engine: Engine) -> None:
        scene = engine.scene
        data = mujoco.MjData(scene.model)
        mujoco.mj_resetDataKeyframe(scene.model, data, scene.model.key(STAND).id)
        mujoco.mj_forward(scene.model, data)
        places = torch.from_numpy(data.sensordata[scene.layout.sensors["foot_position"]]).reshape(-1, 3)
        by_foot = places[:, 2].split(list(scene.layout.foot_sizes))
        self._standing = torch.stack([heights.mean() for heights in by_foot]).float()
        super().__init__(engine)

    def gather(self, rows: Rows = slice(None)) -> SimulationSnapshot:
        """Return the engine's tensors of ``rows``, see :class:`~torchrl_atr.envs.tasks.state.StateExtractor`."""
        return {**super().gather(rows), "world_offset": single(self.engine.world_offset[rows])}

    @property
    def unrecoverable(self) -> dict[str, Tensor]:
        """World positions of the feet, live; see :class:`~torchrl_atr.envs.tasks.state.StateExtractor`."""
        return {"foot_places": self.differentiated[:, -12:]}

    def differentiated_of(self, snapshot: SimulationSnapshot) -> Tensor:
        """Return what the next state differentiates, with the feet's world positions at the end."""
        places = self.foot_positions(snapshot)
        places = torch.cat([places[..., :2] + snapshot["world_offset"].unsqueeze(-2), places[..., 2:]], -1)
        return torch.cat([super().differentiated_of(snapshot), places.flatten(-2)], -1)

    def parts(self, snapshot: SimulationSnapshot, differentiated: Tensor, rates: Tensor) -> dict[str, Any]:
        """Return the fields of the state, see :class:`~torchrl_atr.envs.tasks.state.StateExtractor`."""
        parts = super().parts(snapshot, differentiated, rates)
        along = heading_frame(parts["euler"], parts["velocity"])
        yaw_rate = (parts["rotation"][:, 2] * parts["angular_velocity"]).sum(-1)
        return {
            **parts,
            "speeds": torch.stack([along[:, 0], yaw_rate], -1),
            "lateral_speed": along[:, 1],
            "height": parts["position"][:, 2] - self.engine.scene.support.height,
            "foot_height": parts["foot_position"][..., 2] - self._standing,
            "foot_velocity": rates[:, -12:].unflatten(-1, (4, 3)),
        }

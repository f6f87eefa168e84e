"""State of riding: that of the robot, and of the transporter below it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchrl_atr._errors import InputError
from torchrl_atr.envs.models.boards import BOARD_HEIGHT
from torchrl_atr.envs.models.robot import LEGS
from torchrl_atr.envs.models.scene import columns
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.tasks.riding.drive_law import DriveHook, combination, combine
from torchrl_atr.envs.tasks.rotations import angular_velocity, matrix_from_euler, rotate_back, wrap
from torchrl_atr.envs.tasks.state import QuadrupedState, Rows, SimulationSnapshot, StateExtractor, single

_FEET = slice(-6 - 2 * len(LEGS), -6)
"""Columns of the feet's places among what is differentiated."""


@dataclass
class RidingState(QuadrupedState):
    """State of a robot and its transporter, float32, world frame unless the name says otherwise.

    Attributes:
        platform_position, platform_velocity, platform_acceleration: of the pivot P, (N, 3).
        platform_rotation: (N, 3, 3); platform_euler: (N, 3), yaw in [-π, π]. Of two boards, P has the average
            pitch and no roll.
        driving_tilt: forward and steering tilt, which drive the transporter (Eqs. 1, 3, 7), rad, (N, 2).
        platform_angular_velocity, platform_angular_acceleration: world frame, (N, 3).
        speeds: the drive law's forward speed and yaw rate in P_planar, (N, 2).
        driven_acceleration: v̇ and α of the law at this tilt, m/s² and rad/s², (N, 2).
        foot_slip: speed of each foot over the boards, along them and in the frame of P, m/s, (N, 4).
        relative_position: of the body in the frame of P, horizontal part, m, (N, 2).
        relative_yaw: heading of the body relative to P, rad, (N, 1).
    """

    platform_position: Tensor
    platform_velocity: Tensor
    platform_acceleration: Tensor
    platform_rotation: Tensor
    platform_euler: Tensor
    driving_tilt: Tensor
    platform_angular_velocity: Tensor
    platform_angular_acceleration: Tensor
    speeds: Tensor
    driven_acceleration: Tensor
    foot_slip: Tensor

    def __post_init__(self) -> None:
        super().__post_init__()
        self.relative_position = rotate_back(self.platform_rotation, self.position - self.platform_position)[:, :2]
        self.relative_yaw = wrap(self.euler[:, 2:] - self.platform_euler[:, 2:])


class RidingStateExtractor(StateExtractor):
    """Extractor of a :class:`RidingState` from an engine whose hook is a :class:`DriveHook`."""

    state_type = RidingState

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        _ = self._hook  # raises for a hook of another type
        layout = engine.scene.support_layout
        self._planar_qpos, self._planar_dof = columns(layout.planar_qpos), columns(layout.planar_dof)
        self._heading = int(layout.planar_qpos[2])
        self._tilt_qpos, self._tilt_dof = columns(layout.tilt_qpos), columns(layout.tilt_dof)
        design = engine.scene.support.spec.design
        # both from hinge angles: (n, hinges) @ (hinges, 2)
        self._driving = combination(design.driving, torch.float32)
        pitch, roll = design.attitude
        self._roll_and_pitch = combination((roll, pitch), torch.float32)
        super().__init__(engine)

    @property
    def _hook(self) -> DriveHook:
        hook = self.engine.hook
        if not isinstance(hook, DriveHook):
            raise InputError(
                f"a RidingState needs substep_hook=DriveHook, not {type(hook).__name__}; give the task both"
            )
        return hook

    def gather(self, rows: Rows = slice(None)) -> SimulationSnapshot:
        """Return the engine's tensors of ``rows``; the heading, which is unbounded, wrapped to [-π, π]."""
        snapshot, hook = super().gather(rows), self._hook
        heading = self.engine.qpos[rows][:, self._heading]
        # wrapped before the cast: float32 would lose precision
        snapshot["qpos"][:, self._heading] = heading - 2 * math.pi * (heading / (2 * math.pi)).round()
        snapshot["speeds"] = single(hook.speeds[rows])
        snapshot["driven_acceleration"] = single(hook.acceleration(rows))
        return snapshot

    @property
    def unrecoverable(self) -> dict[str, Tensor]:
        """Places of the feet on the boards, live; see :class:`~torchrl_atr.envs.tasks.state.StateExtractor`."""
        return {"foot_places": self.differentiated[:, _FEET]}

    def interpret(self, snapshot: SimulationSnapshot, previous: Tensor | None) -> tuple[QuadrupedState, Tensor]:
        """Return the state of a snapshot; see :class:`~torchrl_atr.envs.tasks.state.StateExtractor`."""
        state, now = super().interpret(snapshot, previous)
        if previous is None:  # after a reset sensors are of the present
            now[:, _FEET] = self._foot_places(snapshot, age=0.0)
        return state, now

    def differentiated_of(self, snapshot: SimulationSnapshot) -> Tensor:
        """Return what the next state differentiates, (n, V): v_B, q̇, the feet's places on the boards, v_P and ω_P."""
        qvel = snapshot["qvel"]
        planar = qvel[:, self._planar_dof]
        rates = torch.cat([combine(qvel[:, self._tilt_dof], self._roll_and_pitch), planar[:, 2:]], -1)
        platform = pad(planar[:, :2], (0, 1))  # its height is constant
        turning = angular_velocity(self._platform_pose(snapshot["qpos"])[1], rates)
        places = self._foot_places(snapshot, self.engine.timestep)
        return torch.cat([super().differentiated_of(snapshot), places, platform, turning], -1)

    def _platform_pose(self, qpos: Tensor) -> tuple[Tensor, Tensor]:
        """Return position, and roll, pitch and yaw of P, (n, 3) each."""
        planar, attitude = qpos[:, self._planar_qpos], combine(qpos[:, self._tilt_qpos], self._roll_and_pitch)
        return pad(planar[:, :2], (0, 1), value=BOARD_HEIGHT), torch.cat([attitude, planar[:, 2:]], -1)

    def _foot_places(self, snapshot: SimulationSnapshot, age: float) -> Tensor:
        """Return the horizontal places of the feet in the frame of P, (n, 8), by sensors of ``age`` seconds ago.

        P must be of the same instant, or every acceleration would be a slip.
        """
        qpos = snapshot["qpos"].clone()
        for place, dof in ((self._planar_qpos, self._planar_dof), (self._tilt_qpos, self._tilt_dof)):
            qpos[:, place] -= age * snapshot["qvel"][:, dof]
        position, euler = self._platform_pose(qpos)
        rotation = matrix_from_euler(*euler.unbind(-1)).unsqueeze(-3)
        return rotate_back(rotation, self.foot_positions(snapshot) - position.unsqueeze(-2))[..., :2].flatten(-2)

    def parts(self, snapshot: SimulationSnapshot, differentiated: Tensor, rates: Tensor) -> dict[str, Any]:
        """Return the fields of the state, see :class:`~torchrl_atr.envs.tasks.state.StateExtractor`."""
        position, euler = self._platform_pose(snapshot["qpos"])
        return {
            **super().parts(snapshot, differentiated, rates),
            "platform_position": position,
            "platform_velocity": differentiated[:, -6:-3],
            "platform_acceleration": rates[:, -6:-3],
            "platform_rotation": matrix_from_euler(*euler.unbind(-1)),
            "platform_euler": euler,
            "driving_tilt": combine(snapshot["qpos"][:, self._tilt_qpos], self._driving),
            "platform_angular_velocity": differentiated[:, -3:],
            "platform_angular_acceleration": rates[:, -3:],
            "speeds": snapshot["speeds"],
            "driven_acceleration": snapshot["driven_acceleration"],
            "foot_slip": rates[:, _FEET].unflatten(-1, (len(LEGS), 2)).norm(dim=-1),
        }

"""The riding state: the physical quantities that observations, rewards and terminations are functions of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchrl_atr.envs.models.decks import DECK_HEIGHT
from torchrl_atr.envs.models.scene import TIMESTEP
from torchrl_atr.envs.physics.engine import DECIMATION, Engine
from torchrl_atr.envs.task.rotations import (
    euler_from_matrix,
    matrix_from_euler,
    matrix_from_quaternion,
)

CONTROL_DT = TIMESTEP * DECIMATION
"""Control period, s (50 Hz)."""
CONTACT_THRESHOLD = 1.0
"""Force above which something touches, N (reading A35)."""
GRAVITY = 9.81
Rows = NDArray[np.int64] | slice
"""Which robots of a batch: row numbers, or all of them."""


@dataclass
class RidingState:
    """One batch of N robots after a control step, float32, world frame unless the name says otherwise.

    Accelerations are differences over the control step (A32): what a low-passed IMU reports, free of solver
    spikes.

    Attributes:
        position, velocity, acceleration: of the body B's frame origin, (N, 3).
        rotation: body to world, (N, 3, 3).
        euler: roll, pitch, yaw of the body, (N, 3).
        angular_velocity: ω_B in the body frame, (N, 3).
        joint_position, joint_velocity, joint_acceleration, torque: q, q̇, q̈, τ in the spec's order, (N, 12).
        platform_position, platform_velocity, platform_acceleration: of the pivot P, (N, 3).
        platform_rotation: (N, 3, 3); platform_euler: (N, 3). Of two boards, P has the average pitch and no roll.
        driving_tilt: forward and steering tilt, what drives the transporter (Eqs. 1, 3, 7), rad, (N, 2).
        platform_angular_velocity, platform_angular_acceleration: world frame, (N, 3).
        speeds: the drive law's forward speed and yaw rate in P_planar, (N, 2).
        driven_acceleration: v̇ and α that the law gives at this tilt, m/s² and rad/s², (N, 2).
        foot_position, foot_force: (N, 4, 3); forces act on the foot.
        other_force: contact force on the rest of the robot, (N, 3).
        com: the robot's centre of mass, (N, 3).
    """

    position: Tensor
    velocity: Tensor
    acceleration: Tensor
    rotation: Tensor
    euler: Tensor
    angular_velocity: Tensor
    joint_position: Tensor
    joint_velocity: Tensor
    joint_acceleration: Tensor
    torque: Tensor
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
    foot_position: Tensor
    foot_force: Tensor
    other_force: Tensor
    com: Tensor

    @property
    def foot_load(self) -> Tensor:
        """Magnitude of each foot's contact force, N, (N, 4)."""
        return self.foot_force.norm(dim=-1)

    @property
    def contacts(self) -> Tensor:
        """Contact indicators c_i as 0 or 1, (N, 4)."""
        return (self.foot_load > CONTACT_THRESHOLD).to(self.foot_force.dtype)


@dataclass
class Velocities:
    """What the next state differentiates: read at the end of a control step."""

    body: Tensor
    joint: Tensor
    platform: Tensor
    platform_angular: Tensor


class StateReader:
    """Reads a :class:`RidingState` out of an engine, with differences to the previous reading.

    Args:
        engine: either engine.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        layout = engine.scene.layout
        self._joint_qpos = torch.as_tensor(layout.joint_qpos, dtype=torch.long)
        self._joint_dof = torch.as_tensor(layout.joint_dof, dtype=torch.long)
        self._actuators = torch.as_tensor(layout.actuators, dtype=torch.long)
        self._tilt_qpos = torch.as_tensor(layout.tilt_qpos, dtype=torch.long)
        self._tilt_dof = torch.as_tensor(layout.tilt_dof, dtype=torch.long)
        design = engine.scene.transporter.design  # both from hinge angles: (n, 2) @ (2, 2)
        self._driving, self._attitude = torch.tensor(design.driving).T, torch.tensor(design.attitude).T
        self._previous = self._velocities(*self._simulation(slice(None)))

    def forget(self, rows: Rows = slice(None)) -> None:
        """Starts the differences of ``rows`` anew from the present state (after a reset or the like)."""
        self._remember(rows, self._velocities(*self._simulation(rows)))

    def _remember(self, rows: Rows, velocities: Velocities) -> None:
        for name, value in vars(velocities).items():
            getattr(self._previous, name)[rows] = value

    def _simulation(self, rows: Rows) -> tuple[Tensor, Tensor]:
        """``qpos`` and ``qvel`` of ``rows``, cast once."""
        return _float(self.engine.qpos[rows]), _float(self.engine.qvel[rows])

    def _velocities(self, qpos: Tensor, qvel: Tensor) -> Velocities:
        layout = self.engine.scene.layout
        root, planar = layout.root_dof, int(layout.planar_dof[0])
        return Velocities(
            body=qvel[:, root : root + 3],
            joint=qvel[:, self._joint_dof],
            platform=torch.cat([qvel[:, planar : planar + 2], qvel.new_zeros(len(qvel), 1)], -1),
            platform_angular=self._platform_angular_velocity(qpos, qvel),
        )

    def _platform_angular_velocity(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        """Of P, world frame, from its rates: yaw, then pitch, then roll."""
        layout = self.engine.scene.layout
        yaw, pitch = qpos[:, int(layout.planar_qpos[2])], (qpos[:, self._tilt_qpos] @ self._attitude)[:, 0]
        pitch_rate, roll_rate = (qvel[:, self._tilt_dof] @ self._attitude).unbind(-1)
        x, y, z = torch.cos(pitch) * roll_rate, pitch_rate, -torch.sin(pitch) * roll_rate
        cos, sin = torch.cos(yaw), torch.sin(yaw)
        return torch.stack([cos * x - sin * y, sin * x + cos * y, z + qvel[:, int(layout.planar_dof[2])]], -1)

    def read(self, rows: Rows = slice(None), anew: bool = False) -> RidingState:
        """The state of ``rows`` now; accelerations are differences to their previous reading, or zero ``anew``."""
        engine, layout = self.engine, self.engine.scene.layout
        qpos, qvel = self._simulation(rows)
        sensors = _float(engine.sensordata[rows])
        now = self._velocities(qpos, qvel)
        if anew:
            self._remember(rows, now)
        rates = {name: (value - getattr(self._previous, name)[rows]) / CONTROL_DT for name, value in vars(now).items()}
        self._remember(rows, now)
        root, planar = layout.root_qpos, int(layout.planar_qpos[0])
        hinges = qpos[:, self._tilt_qpos]
        pitch, roll = (hinges @ self._attitude).unbind(-1)
        yaw = qpos[:, planar + 2]
        rotation = matrix_from_quaternion(qpos[:, root + 3 : root + 7])
        # contact sensors give the force on the deck; the feet feel the opposite
        foot_force = sensors[:, layout.sensors["foot_force"]].neg().unflatten(-1, (-1, 3))
        robot_force = sensors[:, layout.sensors["robot_force"]].neg()
        return RidingState(
            position=qpos[:, root : root + 3],
            velocity=now.body,
            acceleration=rates["body"],
            rotation=rotation,
            euler=euler_from_matrix(rotation),
            angular_velocity=qvel[:, layout.root_dof + 3 : layout.root_dof + 6],
            joint_position=qpos[:, self._joint_qpos],
            joint_velocity=now.joint,
            joint_acceleration=rates["joint"],
            torque=_float(engine.actuator_force[rows])[:, self._actuators],
            platform_position=torch.cat([qpos[:, planar : planar + 2], torch.full_like(qpos[:, :1], DECK_HEIGHT)], -1),
            platform_velocity=now.platform,
            platform_acceleration=rates["platform"],
            platform_rotation=matrix_from_euler(roll, pitch, yaw),
            platform_euler=torch.stack([roll, pitch, yaw], -1),
            driving_tilt=hinges @ self._driving,
            platform_angular_velocity=now.platform_angular,
            platform_angular_acceleration=rates["platform_angular"],
            speeds=_float(engine.speeds[rows]),
            driven_acceleration=_float(engine.driven_acceleration(rows)),
            foot_position=sensors[:, layout.sensors["foot_position"]].unflatten(-1, (-1, 3)),
            foot_force=foot_force,
            other_force=robot_force - foot_force.sum(-2),
            com=sensors[:, layout.sensors["com"]],
        )


def _float(array: NDArray[np.float64]) -> Tensor:
    return torch.tensor(array, dtype=torch.float32)

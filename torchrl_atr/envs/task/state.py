"""The riding state: the physical quantities that observations, rewards and terminations are functions of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

from torchrl_atr.envs.models.decks import DECK_HEIGHT
from torchrl_atr.envs.models.scene import TIMESTEP, columns
from torchrl_atr.envs.physics.engine import DECIMATION, Engine
from torchrl_atr.envs.task.rotations import (
    angular_velocity,
    euler_from_matrix,
    matrix_from_euler,
    matrix_from_quaternion,
    rotate_back,
    wrap,
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
    spikes. Forces, feet and centre of mass are those that the last substep began with: only relations between them
    mean something, such as the centre of mass over the polygon of the feet.

    Attributes:
        position, velocity, acceleration: of the body B's frame origin, (N, 3).
        rotation: body to world, (N, 3, 3).
        euler: roll, pitch, yaw of the body, (N, 3).
        angular_velocity: ω_B in the body frame, (N, 3).
        joint_position, joint_velocity, joint_acceleration, torque: q, q̇, q̈, τ in the spec's order, (N, 12).
        torque_velocity: q̇ of the instant that ``torque`` is of, the beginning of the last substep, (N, 12).
        platform_position, platform_velocity, platform_acceleration: of the pivot P, (N, 3).
        platform_rotation: (N, 3, 3); platform_euler: (N, 3), yaw in [-π, π]. Of two boards, P has the average
            pitch and no roll.
        driving_tilt: forward and steering tilt, what drives the transporter (Eqs. 1, 3, 7), rad, (N, 2).
        platform_angular_velocity, platform_angular_acceleration: world frame, (N, 3).
        speeds: the drive law's forward speed and yaw rate in P_planar, (N, 2).
        driven_acceleration: v̇ and α that the law gives at this tilt, m/s² and rad/s², (N, 2).
        foot_position, foot_force: (N, 4, 3); forces act on the foot. Of a foot of several geoms, the mean of their
            centres and the sum of their forces.
        other_force: contact force on the rest of the robot, (N, 3).
        com: the robot's centre of mass, (N, 3).
        foot_load: magnitude of each foot's contact force, N, (N, 4).
        contacts: contact indicators c_i as 0 or 1, (N, 4).
        body_acceleration: v̇_B in the body frame, m/s², (N, 3).
        relative_position: of the body in the platform frame, horizontal part, m, (N, 2).
        relative_yaw: heading of the body relative to the platform, rad, (N, 1).
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
    torque_velocity: Tensor
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

    def __post_init__(self) -> None:  # not cached properties: torch.compile cannot look into those
        self.foot_load = self.foot_force.norm(dim=-1)
        self.contacts = (self.foot_load > CONTACT_THRESHOLD).to(self.foot_force.dtype)
        self.body_acceleration = rotate_back(self.rotation, self.acceleration)
        self.relative_position = rotate_back(self.platform_rotation, self.position - self.platform_position)[:, :2]
        self.relative_yaw = wrap(self.euler[:, 2:] - self.platform_euler[:, 2:])


class Readout(NamedTuple):
    """What an engine holds of n robots after a control step, float32, as MuJoCo and the drive law have it."""

    qpos: Tensor
    qvel: Tensor
    sensed: Tensor
    torque: Tensor
    torque_velocity: Tensor
    speeds: Tensor
    driven_acceleration: Tensor


class StateReader:
    """Reads a :class:`RidingState` out of an engine, with differences to the previous reading.

    Args:
        engine: either engine.

    Attributes:
        velocities: of the previous reading, (N, 9 + 12); what the next one's accelerations are differences to.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        layout = engine.scene.layout
        self._root_qpos, self._root_dof = (slice(start, start + 3) for start in (layout.root_qpos, layout.root_dof))
        self._joint_qpos, self._joint_dof = columns(layout.joint_qpos), columns(layout.joint_dof)
        self._planar_qpos, self._planar_dof = columns(layout.planar_qpos), columns(layout.planar_dof)
        self._heading = int(layout.planar_qpos[2])
        self._tilt_qpos, self._tilt_dof = columns(layout.tilt_qpos), columns(layout.tilt_dof)
        self._actuators = columns(layout.actuators)
        self._foot_sizes = layout.foot_sizes
        design = engine.scene.transporter.design  # both from hinge angles: (n, 2) @ (2, 2)
        self._driving = torch.tensor(design.driving, dtype=torch.float32).T
        self._roll_and_pitch = torch.tensor(design.attitude, dtype=torch.float32).flip(0).T
        qpos, qvel = self._simulation(slice(None))
        self._sizes = (3, 3, 3, len(layout.joint_dof))
        self.velocities = self._velocities(qvel, self._platform_euler(qpos))

    def forget(self, rows: Rows = slice(None)) -> None:
        """Starts the differences of ``rows`` anew from the present state (after a reset or the like)."""
        qpos, qvel = self._simulation(rows)
        self.velocities[rows] = self._velocities(qvel, self._platform_euler(qpos))

    def _simulation(self, rows: Rows) -> tuple[Tensor, Tensor]:
        """``qpos`` and ``qvel`` of ``rows``, cast once; the heading, which turns without bound, in [-π, π]."""
        qpos, heading = self.engine.qpos[rows], self._heading
        single = _float(qpos)
        single[:, heading] = torch.from_numpy(_wrapped(qpos[:, heading]))  # before the cast: float32 would lose it
        return single, _float(self.engine.qvel[rows])

    def _platform_euler(self, qpos: Tensor) -> Tensor:
        """Roll, pitch and yaw of P, (n, 3)."""
        attitude = _mix(qpos[:, self._tilt_qpos], self._roll_and_pitch)
        return torch.cat([attitude, qpos[:, self._planar_qpos][:, 2:]], -1)

    def _velocities(self, qvel: Tensor, euler: Tensor) -> Tensor:
        """What the next state differentiates, (n, 9 + 12): v_B, v_P, ω_P (P's attitude is ``euler``), q̇."""
        planar = qvel[:, self._planar_dof]
        rates = torch.cat([_mix(qvel[:, self._tilt_dof], self._roll_and_pitch), planar[:, 2:]], -1)
        platform = pad(planar[:, :2], (0, 1))  # it keeps its height
        turning = angular_velocity(euler, rates)
        return torch.cat([qvel[:, self._root_dof], platform, turning, qvel[:, self._joint_dof]], -1)

    def read(self) -> RidingState:
        """The state of all robots now; accelerations are differences to their previous reading."""
        state, self.velocities = self.interpret(self.gather(), self.velocities)
        return state

    def gather(self, rows: Rows = slice(None)) -> Readout:
        """The engine's arrays of ``rows``, copied and cast once."""
        engine = self.engine
        return Readout(
            *self._simulation(rows),
            _float(engine.sensordata[rows]),
            _float(engine.actuator_force[rows]),
            _float(engine.torque_velocity[rows]),
            _float(engine.speeds[rows]),
            _float(engine.driven_acceleration(rows)),
        )

    def interpret(self, readout: Readout, previous: Tensor | None) -> tuple[RidingState, Tensor]:
        """The state that a readout shows, and its velocities; touches nothing else.

        Args:
            readout: of n robots.
            previous: their velocities a control step ago, to which accelerations are differences; None: they are zero.
        """
        qpos, qvel, sensed, torque, torque_velocity, speeds, driven_acceleration = readout
        sensors = self.engine.scene.layout.sensors
        platform_euler = self._platform_euler(qpos)
        now = self._velocities(qvel, platform_euler)
        rates = torch.zeros_like(now) if previous is None else (now - previous) / CONTROL_DT
        velocity, platform_velocity, platform_turning, joint_velocity = now.split(self._sizes, -1)
        acceleration, platform_acceleration, platform_twist, joint_acceleration = rates.split(self._sizes, -1)
        rotation = matrix_from_quaternion(qpos[:, self._root_qpos.stop : self._root_qpos.stop + 4])
        # contact sensors give the force on the deck; the feet feel the opposite
        foot_force = _by_foot(sensed[:, sensors["foot_force"]].neg(), self._foot_sizes, torch.sum)
        state = RidingState(
            position=qpos[:, self._root_qpos],
            velocity=velocity,
            acceleration=acceleration,
            rotation=rotation,
            euler=euler_from_matrix(rotation),
            angular_velocity=qvel[:, self._root_dof.stop : self._root_dof.stop + 3],
            joint_position=qpos[:, self._joint_qpos],
            joint_velocity=joint_velocity,
            joint_acceleration=joint_acceleration,
            torque=torque[:, self._actuators],
            torque_velocity=torque_velocity,
            platform_position=pad(qpos[:, self._planar_qpos][:, :2], (0, 1), value=DECK_HEIGHT),
            platform_velocity=platform_velocity,
            platform_acceleration=platform_acceleration,
            platform_rotation=matrix_from_euler(*platform_euler.unbind(-1)),
            platform_euler=platform_euler,
            driving_tilt=_mix(qpos[:, self._tilt_qpos], self._driving),
            platform_angular_velocity=platform_turning,
            platform_angular_acceleration=platform_twist,
            speeds=speeds,
            driven_acceleration=driven_acceleration,
            foot_position=_by_foot(sensed[:, sensors["foot_position"]], self._foot_sizes, torch.mean),
            foot_force=foot_force,
            other_force=-sensed[:, sensors["robot_force"]] - foot_force.sum(-2),
            com=sensed[:, sensors["com"]],
        )
        return state, now


def _by_foot(values: Tensor, sizes: tuple[int, ...], reduce: Callable[..., Tensor]) -> Tensor:
    """Vectors of geoms, (n, 3 G), reduced to those of feet that have so many geoms each, (n, 4, 3)."""
    vectors = values.unflatten(-1, (-1, 3))
    if len(sizes) == vectors.shape[-2]:
        return vectors
    return torch.stack([reduce(foot, -2) for foot in vectors.split(sizes, -2)], -2)


def _mix(angles: Tensor, matrix: Tensor) -> Tensor:
    """``angles @ matrix``, (n, 2), written out: compiled loops need not end for it."""
    return angles[:, :1] * matrix[0] + angles[:, 1:] * matrix[1]


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """The angle in [-π, π]; within it, as it is to the last bit."""
    return angle - 2 * np.pi * np.rint(angle / (2 * np.pi))


def _float(array: NDArray[np.float64]) -> Tensor:
    return torch.from_numpy(array.astype(np.float32, order="C"))  # half of what torch.tensor takes

"""State of a robot: the physical quantities that observations, rewards and terminations are functions of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchrl_atr.envs.models.scene import columns
from torchrl_atr.envs.physics.engine import CONTROL_DT, Engine
from torchrl_atr.envs.tasks.rotations import euler_from_matrix, matrix_from_quaternion, rotate_back

CONTACT_THRESHOLD = 1.0
"""Force above which there is contact, N (question A35)."""
GRAVITY = 9.81
Rows = Tensor | slice
"""Rows of a batch: row numbers, or all of them."""
SimulationSnapshot = dict[str, Tensor]
"""Engine's tensors of n robots after a control step, float32, by the names of MuJoCo and of the engine's hook."""


@dataclass
class QuadrupedState:
    """State of N robots after a control step, float32, world frame unless the name says otherwise.

    Accelerations are differences over the control step (A32), like those of a low-passed IMU, free of solver
    spikes. Forces, feet and centre of mass are those at the start of the last substep: use only relations between
    them, such as the centre of mass over the polygon of the feet.

    Attributes:
        position, velocity, acceleration: of the body B's frame origin, (N, 3).
        rotation: body to world, (N, 3, 3).
        euler: roll, pitch, yaw of the body, (N, 3).
        angular_velocity: ω_B in the body frame, (N, 3).
        joint_position, joint_velocity, joint_acceleration, torque: q, q̇, q̈, τ in the spec's order, (N, 12).
        torque_velocity: q̇ at the instant of ``torque``, the start of the last substep, (N, 12).
        foot_position, foot_force: (N, 4, 3); forces act on the foot. Of a foot of several geoms, the mean of their
            centres and the sum of their forces.
        other_force: contact force on the rest of the robot, (N, 3).
        com: the robot's centre of mass, (N, 3).
        foot_load: magnitude of each foot's contact force, N, (N, 4).
        contacts: contact indicators c_i as 0 or 1, (N, 4).
        body_acceleration: v̇_B in the body frame, m/s², (N, 3).
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
    foot_position: Tensor
    foot_force: Tensor
    other_force: Tensor
    com: Tensor

    def __post_init__(self) -> None:  # not cached properties: torch.compile cannot trace those
        self.foot_load = self.foot_force.norm(dim=-1)
        self.contacts = (self.foot_load > CONTACT_THRESHOLD).to(self.foot_force.dtype)
        self.body_acceleration = rotate_back(self.rotation, self.acceleration)


class StateExtractor:
    """Extractor of a :class:`QuadrupedState` from an engine, with differences to the previous one.

    A task with its own state subclasses it: :meth:`gather` for more of the engine's tensors, :meth:`differentiated_of`
    for more quantities to differentiate, :meth:`parts` for more fields of ``state_type``, :attr:`unrecoverable` for
    those parts of the previous state that an engine's restored state does not give.

    Args:
        engine: any engine.

    Attributes:
        state_type: type of the states that :meth:`interpret` returns.
        differentiated: velocities, and positions of feet, of the previous state, (N, V), to which the next one takes
            differences.
    """

    state_type: ClassVar[type[QuadrupedState]] = QuadrupedState

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        layout = engine.scene.layout
        self._root_qpos, self._root_dof = (slice(start, start + 3) for start in (layout.root_qpos, layout.root_dof))
        self._joint_qpos, self._joint_dof = columns(layout.joint_qpos), columns(layout.joint_dof)
        self._actuators = columns(layout.actuators)
        self._sensors, self._foot_sizes = layout.sensors, layout.foot_sizes
        self.differentiated = self.differentiated_of(self.gather())

    @property
    def unrecoverable(self) -> dict[str, Tensor]:
        """Live parts of ``differentiated``, by name, that :meth:`forget` cannot read from an engine's restored state.

        Such as sensor values: after a restore they are of the present, not of the start of the last substep.
        """
        return {}

    def forget(self, rows: Rows = slice(None)) -> None:
        """Restart the differences of ``rows`` from the present state, as after a reset."""
        self.differentiated[rows] = self.interpret(self.gather(rows), None)[1]

    def read(self) -> QuadrupedState:
        """Return the state of all robots now; accelerations are differences to the previous one."""
        state, self.differentiated = self.interpret(self.gather(), self.differentiated)
        return state

    def gather(self, rows: Rows = slice(None)) -> SimulationSnapshot:
        """Return the engine's tensors of ``rows``, copied and cast once."""
        engine = self.engine
        return {
            "qpos": single(engine.qpos[rows]),
            "qvel": single(engine.qvel[rows]),
            "sensed": single(engine.sensordata[rows]),
            "torque": single(engine.actuator_force[rows]),
            "torque_velocity": single(engine.torque_velocity[rows]),
        }

    def differentiated_of(self, snapshot: SimulationSnapshot) -> Tensor:
        """Return what the next state differentiates, (n, V): v_B and q̇ first."""
        qvel = snapshot["qvel"]
        return torch.cat([qvel[:, self._root_dof], qvel[:, self._joint_dof]], -1)

    def interpret(self, snapshot: SimulationSnapshot, previous: Tensor | None) -> tuple[QuadrupedState, Tensor]:
        """Return the state of a snapshot, and what the next one differentiates; without side effects.

        Args:
            snapshot: of n robots.
            previous: :meth:`differentiated_of` it a control step ago; None: the rates are zero.
        """
        now = self.differentiated_of(snapshot)
        rates = torch.zeros_like(now) if previous is None else (now - previous) / CONTROL_DT
        return self.state_type(**self.parts(snapshot, now, rates)), now

    def foot_positions(self, snapshot: SimulationSnapshot) -> Tensor:
        """Return the positions of the feet, m, (n, 4, 3)."""
        return _by_foot(snapshot["sensed"][:, self._sensors["foot_position"]], self._foot_sizes, torch.mean)

    def parts(self, snapshot: SimulationSnapshot, differentiated: Tensor, rates: Tensor) -> dict[str, Any]:
        """Return the fields of the state.

        Args:
            snapshot: of n robots.
            differentiated: :meth:`differentiated_of` it, (n, V).
            rates: their derivatives, (n, V).
        """
        qpos, qvel, sensed, sensors = snapshot["qpos"], snapshot["qvel"], snapshot["sensed"], self._sensors
        joints = qpos[:, self._joint_qpos]
        end = 3 + joints.shape[-1]
        rotation = matrix_from_quaternion(qpos[:, self._root_qpos.stop : self._root_qpos.stop + 4])
        # contact sensors give the force on the support; the force on the feet is the opposite
        foot_force = _by_foot(sensed[:, sensors["foot_force"]].neg(), self._foot_sizes, torch.sum)
        return {
            "position": qpos[:, self._root_qpos],
            "velocity": differentiated[:, :3],
            "acceleration": rates[:, :3],
            "rotation": rotation,
            "euler": euler_from_matrix(rotation),
            "angular_velocity": qvel[:, self._root_dof.stop : self._root_dof.stop + 3],
            "joint_position": joints,
            "joint_velocity": differentiated[:, 3:end],
            "joint_acceleration": rates[:, 3:end],
            "torque": snapshot["torque"][:, self._actuators],
            "torque_velocity": snapshot["torque_velocity"],
            "foot_position": self.foot_positions(snapshot),
            "foot_force": foot_force,
            "other_force": -sensed[:, sensors["robot_force"]] - foot_force.sum(-2),
            "com": sensed[:, sensors["com"]],
        }


def single(values: Tensor) -> Tensor:
    """Return a float32 copy."""
    return values.to(torch.float32, copy=True)


def _by_foot(values: Tensor, sizes: tuple[int, ...], reduce: Callable[..., Tensor]) -> Tensor:
    """Reduce vectors of geoms, (n, 3 G), to those of feet with ``sizes`` geoms each, (n, 4, 3)."""
    vectors = values.unflatten(-1, (-1, 3))
    if len(sizes) == vectors.shape[-2]:
        return vectors
    return torch.stack([reduce(foot, -2) for foot in vectors.split(sizes, -2)], -2)

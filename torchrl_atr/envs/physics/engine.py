"""The engine's interface and everything the two engines share: the control step, the prescribed motion, recentring."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.models.scene import TIMESTEP, Scene
from torchrl_atr.envs.physics.law import DriveLaw
from torchrl_atr.envs.profiles import Readings

Array = NDArray[np.float64]
DECIMATION = 4
"""Simulation substeps in a control step: 200 Hz and 50 Hz."""

_DIVERGED = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),
]


@dataclass(frozen=True)
class PhysicalParameters:
    """What Table II randomises, in physical units, for the n robots being reset.

    Attributes:
        payload: mass added to the trunk, kg, (n,).
        com_shift: displacement of the trunk's centre of mass, m, (n, 3).
        kp: PD stiffness, N m/rad, (n, 12).
        kd: PD damping, N m s/rad, (n, 12).
        platform_mass: kg, (n,).
        friction: sliding friction between feet and deck, (n,).
        sb_stiffness: self-balancing stiffness (roll, pitch), N m/rad, (n, 2).
        sb_damping: self-balancing damping (roll, pitch), N m s/rad, (n, 2).
    """

    payload: Array
    com_shift: Array
    kp: Array
    kd: Array
    platform_mass: Array
    friction: Array
    sb_stiffness: Array
    sb_damping: Array


class Engine(ABC):
    """N simulations of one scene, advanced by control steps.

    Subclasses provide the arrays below, each with a leading axis of N, and :meth:`_substep`; this class evaluates the
    drive law before every substep and turns its planar speeds into the force that produces them in that substep. Writing
    velocities instead would hide the deck's acceleration from the contact solver and let the feet slip.

    Attributes:
        qpos, qvel, ctrl, qfrc_applied: live state, (N, nq | nv | nu | nv), float64.
        sensordata: after a control step, current; contact forces are those of the last substep.
        speeds: the law's own state (v_f, ω_z), (N, 2).
        odometer: deck position in the world, m, (N, 2), since recentring keeps ``qpos`` near the origin.
        diverged: simulations that MuJoCo reset during the last control step, (N,) bool.
    """

    scene: Scene
    num_envs: int
    qpos: Array
    qvel: Array
    ctrl: Array
    qfrc_applied: Array

    def __init__(self, scene: Scene, num_envs: int, readings: Readings) -> None:
        self.scene = scene
        self.num_envs = num_envs
        self.law = DriveLaw(scene.transporter, readings)
        self.speeds = np.zeros((num_envs, 2))
        self.odometer = np.zeros((num_envs, 2))
        self.diverged = np.zeros(num_envs, dtype=bool)
        self._deck_mass = np.full(num_envs, scene.transporter.mass)
        self._scale = self.law.mass_scale(self._deck_mass)
        self._planar_inertia = np.empty((num_envs, 3))
        self._refresh_deck(np.arange(num_envs), self._deck_mass)

    @property
    @abstractmethod
    def sensordata(self) -> Array:
        """Sensor readings, (N, nsensordata)."""

    @property
    @abstractmethod
    def actuator_force(self) -> Array:
        """Joint torques of the last substep in MJCF actuator order, N m, (N, nu)."""

    @property
    @abstractmethod
    def warmstart(self) -> Array:
        """The solver's warm start, live, (N, nv): part of the state that bit-identical continuation needs."""

    @abstractmethod
    def _substep(self, last: bool) -> None:
        """One simulation step; after the last one, position and velocity quantities must be current."""

    @abstractmethod
    def _warnings(self) -> NDArray[np.int64]:
        """Cumulative MuJoCo warning counts, (N, kinds)."""

    @abstractmethod
    def _write_parameters(self, rows: NDArray[np.int64], parameters: PhysicalParameters) -> None:
        """Writes Table II's parameters into the compiled fields of ``rows`` and refreshes derived constants."""

    @abstractmethod
    def _restart(self, rows: NDArray[np.int64], qpos: Array, qvel: Array) -> None:
        """Resets ``rows`` to the given state with ctrl = q0 and computes position and velocity quantities."""

    @abstractmethod
    def forward(self) -> None:
        """Recomputes position and velocity quantities from the state (after it was written from outside)."""

    def step(self, targets: Array) -> None:
        """One control step: ``DECIMATION`` x (law, planar force, simulation step).

        Args:
            targets: joint targets in the spec's joint order, rad, (N, 12).
        """
        self._recentre()
        before = self._warnings()[:, _DIVERGED].copy()
        self.ctrl[:, self.scene.layout.actuators] = targets
        for substep in range(DECIMATION):
            self.prescribe()
            self._substep(last=substep == DECIMATION - 1)
        self.diverged = (self._warnings()[:, _DIVERGED] > before).any(axis=1)

    def prescribe(self) -> None:
        """Evaluates the law at the current tilt and applies the force that realises it within the coming substep."""
        layout, dt = self.scene.layout, TIMESTEP
        self.speeds = self.law(self.speeds, self.qpos[:, layout.tilt_qpos], self._scale, dt)
        speed, yaw_rate = self.speeds[:, 0], self.speeds[:, 1]
        heading = self.qpos[:, layout.planar_qpos[2]] + dt * yaw_rate
        target = np.stack([speed * np.cos(heading), speed * np.sin(heading), yaw_rate], axis=-1)  # Eq. 2
        error = target - self.qvel[:, layout.planar_dof]
        self.qfrc_applied[:, layout.planar_dof] = self._planar_inertia * error / dt

    def reset(self, rows: NDArray[np.int64], qpos: Array, qvel: Array, parameters: PhysicalParameters) -> None:
        """Starts new episodes: fresh parameters, state, and a transporter at rest.

        Args:
            rows: which simulations, (n,) integers; the others are left exactly as they are.
            qpos: (n, nq).
            qvel: (n, nv).
            parameters: for those rows.
        """
        self._write_parameters(rows, parameters)
        self._refresh_deck(rows, parameters.platform_mass)
        self.speeds[rows] = 0.0
        self.odometer[rows] = 0.0
        self.diverged[rows] = False
        self._restart(rows, qpos, qvel)

    def _refresh_deck(self, rows: NDArray[np.int64], mass: Array) -> None:
        deck, armature = self.scene.transporter, self.scene.model.dof_armature[self.scene.layout.planar_dof]
        self._deck_mass[rows] = mass
        self._scale[rows] = self.law.mass_scale(mass)
        inertia = np.stack([mass, mass, mass / deck.mass * deck.inertia[2]], axis=-1)
        self._planar_inertia[rows] = armature + inertia

    def _recentre(self) -> None:
        """Moves deck and robot back to the origin together: physics is translation invariant, floats are not."""
        layout = self.scene.layout
        planar = layout.planar_qpos[:2]
        offset = self.qpos[:, planar].copy()
        self.odometer += offset
        self.qpos[:, planar] -= offset
        self.qpos[:, layout.root_qpos : layout.root_qpos + 2] -= offset

    def get_state(self) -> dict[str, Array]:
        """Everything a later :meth:`set_state` needs to continue bit for bit (parameters excepted)."""
        return {
            "qpos": self.qpos.copy(),
            "qvel": self.qvel.copy(),
            "ctrl": self.ctrl.copy(),
            "warmstart": self.warmstart.copy(),
            "speeds": self.speeds.copy(),
            "odometer": self.odometer.copy(),
        }

    def set_state(self, state: dict[str, Array]) -> None:
        """Restores a state taken by :meth:`get_state`, on either engine.

        Raises:
            KeyError: if a field is missing.
            ValueError: if a field's shape does not fit this engine.
        """
        live = {
            "qpos": self.qpos,
            "qvel": self.qvel,
            "ctrl": self.ctrl,
            "warmstart": self.warmstart,
            "speeds": self.speeds,
            "odometer": self.odometer,
        }
        for name, target in live.items():
            if name not in state:
                raise KeyError(f"the state lacks {name!r}; it needs {', '.join(live)}")
            value = np.asarray(state[name])
            if value.shape != target.shape:
                raise ValueError(f"state field {name!r} has shape {value.shape}; this engine needs {target.shape}")
            target[...] = value
        self.forward()
        self.warmstart[...] = state["warmstart"]

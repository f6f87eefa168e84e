"""What the two engines share: the control step, the prescribed motion, recentring, parameters, state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.models.scene import TIMESTEP, Scene, columns
from torchrl_atr.envs.physics.law import DriveLaw
from torchrl_atr.envs.profiles import Readings

Array = NDArray[np.float64]
DECIMATION = 4
"""Simulation substeps in a control step: 200 Hz and 50 Hz."""

RANDOMIZED_FIELDS = (
    "body_mass",
    "body_inertia",
    "body_ipos",
    "actuator_gainprm",
    "actuator_biasprm",
    "geom_friction",
    "jnt_stiffness",
    "dof_damping",
)
"""Fields of the compiled model that differ between simulations."""
_WARNINGS = mujoco.mjtWarning
_DIVERGED = columns(
    np.array([_WARNINGS.mjWARN_BADQPOS, _WARNINGS.mjWARN_BADQVEL, _WARNINGS.mjWARN_BADQACC, _WARNINGS.mjWARN_BADCTRL])
)


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
        sb_stiffness: self-balancing stiffness in Table II's order (roll, pitch; or right, left), N m/rad, (n, 2).
        sb_damping: self-balancing damping, likewise, N m s/rad, (n, 2).
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

    Subclasses provide the arrays below, each with a leading axis of N, and :meth:`_substep`; this class
    evaluates the drive law before every substep and turns its planar speeds into the force that produces them
    in that substep. Writing velocities instead would hide the deck's acceleration from the contact solver and
    let the feet slip.

    Attributes:
        qpos, qvel, ctrl, qfrc_applied: live state, (N, nq | nv | nu | nv), float64.
        time: live simulation time, s, (N,); MuJoCo starts it anew when it resets a diverged simulation.
        warmstart: the solver's warm start, live, (N, nv): part of the state that bit-identical continuation
            needs.
        sensordata: sensor readings of the state that the last substep began with, (N, nsensordata).
        actuator_force: joint torques of the last substep in MJCF actuator order, N m, (N, nu).
        speeds: the law's own state (v_f, ω_z), (N, 2).
        odometer: deck position in the world, m, (N, 2), since recentring keeps ``qpos`` near the origin.
        torque_velocity: joint velocities when ``actuator_force`` was computed, in the spec's joint order, rad/s,
            (N, 12): a torque times a later velocity is no power.
        diverged: simulations that MuJoCo reset or refused to step during the last :meth:`advance`, (N,) bool.
        fields: live per-simulation values of the :data:`RANDOMIZED_FIELDS` of the compiled model, (N, ...)
            each.
    """

    scene: Scene
    num_envs: int
    qpos: Array
    qvel: Array
    ctrl: Array
    qfrc_applied: Array
    time: Array
    warmstart: Array
    sensordata: Array
    actuator_force: Array
    fields: dict[str, Array]

    def __init__(self, scene: Scene, num_envs: int, readings: Readings) -> None:
        self.scene = scene
        self.num_envs, self.readings = num_envs, readings
        self.law = DriveLaw(scene.transporter, readings)
        self._tilt, self._planar = columns(scene.layout.tilt_qpos), columns(scene.layout.planar_dof)
        self._place = columns(scene.layout.planar_qpos[:2])
        self._heading = int(scene.layout.planar_qpos[2])
        self._joints = columns(scene.layout.joint_dof)
        self.torque_velocity = np.zeros((num_envs, len(scene.layout.joint_dof)))
        self.speeds = np.zeros((num_envs, 2))
        self.odometer = np.zeros((num_envs, 2))
        self.diverged = np.zeros(num_envs, dtype=bool)
        self._deck_mass = np.full(num_envs, scene.transporter.mass)
        self._scale = self.law.mass_scale(self._deck_mass)
        self._planar_inertia, self._planar_force = np.empty((2, num_envs, 3))
        self._refresh_deck(np.arange(num_envs), self._deck_mass)

    @abstractmethod
    def _substep(self, last: bool) -> None:
        """One simulation step; what it derives is of the state it began with. Sensors are read after the ``last``."""

    @abstractmethod
    def _warnings(self) -> NDArray[np.int64]:
        """Cumulative MuJoCo warning counts, (N, kinds)."""

    @abstractmethod
    def _refresh_constants(self, rows: NDArray[np.int64]) -> None:
        """Derives anew what MuJoCo computes from :attr:`fields` (``mj_setConst``)."""

    @abstractmethod
    def _restart(self, rows: NDArray[np.int64], qpos: Array, qvel: Array) -> None:
        """Resets ``rows`` to the given state with ctrl = q0 and computes all that follows from it."""

    @abstractmethod
    def forward(self) -> None:
        """Recomputes all derived quantities from the state (after it was written from outside)."""

    def step(self, targets: Array) -> None:
        """One control step: :meth:`command`, then ``DECIMATION`` substeps.

        Args:
            targets: joint targets in the spec's joint order, rad, (N, 12).
        """
        self.command(targets)
        self.advance(DECIMATION)

    def command(self, targets: Array) -> None:
        """Opens a control step: recentres and hands the PD controllers their targets, rad, (N, 12)."""
        self._recentre()
        self.ctrl[:, self.scene.layout.actuators] = targets

    def advance(self, substeps: int) -> None:
        """``substeps`` x (law, planar force, simulation step); notes which simulations diverged."""
        warned, expected = self._warnings()[:, _DIVERGED].copy(), self.time + substeps * TIMESTEP
        for number in range(1, substeps + 1):
            self.prescribe()
            if number == substeps:
                self.torque_velocity[...] = self.qvel[:, self._joints]
            self._substep(last=number == substeps)
        # MuJoCo's own reset also zeroes the counts: a second divergence in a row shows in the time alone
        warned_anew = (self._warnings()[:, _DIVERGED] > warned).any(axis=1)
        self.diverged = np.asarray(warned_anew | (np.abs(self.time - expected) > 0.5 * TIMESTEP))
        self.speeds[self.diverged] = 0.0

    def prescribe(self) -> None:
        """Evaluates the law at the current tilt and applies the force that realises it in one substep."""
        dt = TIMESTEP
        self.speeds = self.law(self.speeds, self.qpos[:, self._tilt], self._scale, dt)
        (speed, yaw_rate), force = self.speeds.T, self._planar_force
        heading = self.qpos[:, self._heading] + dt * yaw_rate
        np.multiply(speed, np.cos(heading), out=force[:, 0])  # Eq. 2: first the velocity that is wanted
        np.multiply(speed, np.sin(heading), out=force[:, 1])
        force[:, 2] = yaw_rate
        force -= self.qvel[:, self._planar]
        force *= self._planar_inertia
        force /= dt
        self.qfrc_applied[:, self._planar] = force

    def driven_acceleration(self, rows: NDArray[np.int64] | slice) -> Array:
        """v̇ and α that the law gives ``rows`` at their present tilt and speeds, m/s² and rad/s², (n, 2)."""
        speeds, tilt = self.speeds[rows], self.qpos[rows][:, self._tilt]
        return (self.law(speeds, tilt, self._scale[rows], TIMESTEP) - speeds) / TIMESTEP

    def reset(self, rows: NDArray[np.int64], qpos: Array, qvel: Array, parameters: PhysicalParameters) -> None:
        """Starts new episodes: fresh parameters and state, the transporters heading along x.

        Args:
            rows: which simulations, (n,) integers; the others are left exactly as they are.
            qpos: (n, nq).
            qvel: (n, nv); the drive law starts from its planar speeds.
            parameters: for those rows.
        """
        self._write_parameters(rows, parameters)
        self._refresh_constants(rows)
        self._refresh_deck(rows, parameters.platform_mass)
        forward, _, yaw = self.scene.layout.planar_dof
        self.speeds[rows] = qvel[:, [forward, yaw]]
        self.odometer[rows] = 0.0
        self.diverged[rows] = False
        self._restart(rows, qpos, qvel)
        self.torque_velocity[rows] = self.qvel[rows][:, self._joints]

    def _write_parameters(self, rows: NDArray[np.int64], parameters: PhysicalParameters) -> None:
        """Writes Table II's parameters into the fields of ``rows``, starting from the nominal model."""
        model, layout, fields = self.scene.model, self.scene.layout, self.fields
        trunk, each = layout.trunk_body, rows[:, None]
        shares = parameters.platform_mass / self.scene.transporter.mass
        scales = {trunk: 1.0 + parameters.payload / model.body_mass[trunk]} | dict.fromkeys(layout.deck_bodies, shares)
        for body, scale in scales.items():
            fields["body_mass"][rows, body] = scale * model.body_mass[body]
            fields["body_inertia"][rows, body] = scale[:, None] * model.body_inertia[body]
        fields["body_ipos"][rows, trunk] = model.body_ipos[trunk] + parameters.com_shift
        fields["actuator_gainprm"][each, layout.actuators, 0] = parameters.kp
        fields["actuator_biasprm"][each, layout.actuators, 1] = -parameters.kp
        fields["actuator_biasprm"][each, layout.actuators, 2] = -parameters.kd
        fields["geom_friction"][each, layout.deck_geoms, 0] = parameters.friction[:, None]
        fields["jnt_stiffness"][each, layout.tilt_joints] = parameters.sb_stiffness[:, layout.tilt_gains]
        fields["dof_damping"][each, layout.tilt_dof] = parameters.sb_damping[:, layout.tilt_gains]

    def _refresh_deck(self, rows: NDArray[np.int64], mass: Array) -> None:
        deck, armature = self.scene.transporter, self.scene.model.dof_armature[self.scene.layout.planar_dof]
        self._deck_mass[rows] = mass
        self._scale[rows] = self.law.mass_scale(mass)
        inertia = np.stack([mass, mass, mass / deck.mass * deck.inertia[2]], axis=-1)
        self._planar_inertia[rows] = armature + inertia

    def _recentre(self) -> None:
        """Moves deck and robot back to the origin: physics is translation invariant, floats are not."""
        root = self.scene.layout.root_qpos
        offset = self.qpos[:, self._place].copy()
        self.odometer += offset
        self.qpos[:, self._place] -= offset
        self.qpos[:, root : root + 2] -= offset

    @property
    def live_state(self) -> dict[str, Array]:
        """The arrays that make up the state, not copied; stale after the next step."""
        names = ("qpos", "qvel", "ctrl", "warmstart", "speeds", "odometer")
        return {name: getattr(self, name) for name in names}

    def get_state(self) -> dict[str, Array]:
        """Everything a later :meth:`set_state` needs to continue bit for bit (parameters excepted)."""
        return {name: array.copy() for name, array in self.live_state.items()}

    def set_state(self, state: dict[str, Array]) -> None:
        """Restores a state taken by :meth:`get_state`, on either engine.

        Raises:
            KeyError: if a field is missing.
            ValueError: if a field's shape does not fit this engine.
        """
        live = self.live_state
        for name, target in live.items():
            if name not in state:
                raise KeyError(f"the state lacks {name!r}; it needs {', '.join(live)}")
            value = np.asarray(state[name])
            if value.shape != target.shape:
                raise ValueError(f"state field {name!r} has shape {value.shape}; this engine needs {target.shape}")
            target[...] = value
        self.forward()
        self.torque_velocity[...] = self.qvel[:, self._joints]
        for name, target in live.items():  # MuJoCo wrote a new warm start, and began anew where a state is not finite
            target[...] = state[name]

    @property
    @abstractmethod
    def _arguments(self) -> tuple[Any, ...]:
        """Arguments that the constructor was called with."""

    @abstractmethod
    def _set_time(self, time: Array) -> None:
        """Writes the simulation time, s, (N,)."""

    def __getstate__(self) -> dict[str, Any]:
        """Constructor arguments and numbers: MuJoCo's own objects can neither be pickled nor copied."""
        return {
            "arguments": self._arguments,
            "deck_mass": self._deck_mass.copy(),
            "fields": {name: np.array(value) for name, value in self.fields.items()},
            "state": self.get_state(),
            "time": np.array(self.time),
            "diverged": self.diverged.copy(),
        }

    def __setstate__(self, saved: dict[str, Any]) -> None:
        """Builds the simulations anew and brings them to where the original's were; sensors are of that state."""
        self.__init__(*saved["arguments"])  # type: ignore[misc]
        rows = np.arange(self.num_envs)
        for name, value in saved["fields"].items():
            self.fields[name][...] = value
        self._refresh_constants(rows)
        self._refresh_deck(rows, saved["deck_mass"])
        self.set_state(saved["state"])
        self._set_time(saved["time"])
        self.diverged[:] = saved["diverged"]

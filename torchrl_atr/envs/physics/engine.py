"""Base class of engines: control step with its substep hook, recentring, per-simulation fields, state.

An engine takes and returns tensors on its device. ``batch`` (N robots on all CPUs) and ``dm_control`` (one robot, the
reference) share memory with MuJoCo; one on a GPU has its own.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchrl_atr._threads import one_torch_thread
from torchrl_atr.envs.models.scene import TIMESTEP, Scene, columns
from torchrl_atr.envs.physics.fields import ModelFields as ModelFields
from torchrl_atr.envs.physics.hook import SubstepHook, check_hook
from torchrl_atr.envs.physics.target_delay import TargetDelay

DECIMATION = 4
"""Simulation substeps in a control step: 200 Hz and 50 Hz."""
CONTROL_DT = TIMESTEP * DECIMATION
"""Control period, s (50 Hz)."""
_WARNINGS = mujoco.mjtWarning
_DIVERGED = columns(
    np.array([_WARNINGS.mjWARN_BADQPOS, _WARNINGS.mjWARN_BADQVEL, _WARNINGS.mjWARN_BADQACC, _WARNINGS.mjWARN_BADCTRL])
)

_STATE = ("qpos", "qvel", "ctrl", "warmstart", "world_offset")
"""Attributes that make up an engine's state, besides its hook's."""


class Engine(ABC):
    """Engine: N simulations of one scene, advanced by control steps.

    Subclasses provide the tensors below, each with a leading axis of N, and the abstract methods.

    Args:
        scene: the compiled scene.
        num_envs: N.
        make_hook: called with the engine, returns the hook that acts before every substep; None for nothing. It must be
            picklable where engines are copied or sent to other processes.
        action_delay: time after which joint targets take effect, s.

    Attributes:
        device: of all tensors.
        qpos, qvel, ctrl, qfrc_applied: live state, (N, nq | nv | nu | nv), float64.
        time: live simulation time, s, (N,); MuJoCo sets it to zero when it resets a diverged simulation.
        warmstart: the solver's warm start, live, (N, nv): part of the state that bit-identical continuation needs.
        sensordata: sensor readings of the state that the last substep began with, (N, nsensordata).
        actuator_force: joint torques of the last substep in MJCF actuator order, N m, (N, nu).
        torque_velocity: joint velocities when ``actuator_force`` was computed, in the spec's joint order, rad/s,
            (N, 12): a torque times a later velocity is no power.
        world_offset: world position of the recentred frame, m, (N, 2), since ``qpos`` is kept near the origin.
        diverged: simulations that MuJoCo reset or refused to step during the last :meth:`advance`, (N,) bool.
        fields: live per-simulation values of fields of the compiled model.
        hook: acts before every substep.
    """

    device = torch.device("cpu")
    qpos: Tensor
    qvel: Tensor
    ctrl: Tensor
    qfrc_applied: Tensor
    time: Tensor
    warmstart: Tensor
    sensordata: Tensor
    actuator_force: Tensor
    fields: ModelFields

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        make_hook: Callable[[Engine], SubstepHook] | None = None,
        action_delay: float = 0.0,
    ) -> None:
        self.scene, self.num_envs, self.make_hook, self.action_delay = scene, num_envs, make_hook, action_delay
        self.timestep = float(scene.model.opt.timestep)
        self.decimation, late = round(CONTROL_DT / self.timestep), round(action_delay / self.timestep)
        stand = torch.tensor(scene.robot.q0, dtype=torch.float64)
        self._delay = TargetDelay(late, self.decimation, stand, num_envs) if late else None
        layout = scene.layout
        self._joints, self._actuators = columns(layout.joint_dof), columns(layout.actuators)
        self._origin = columns(layout.origin_qpos)
        self._carried = [columns(each) for each in layout.carried_qpos]
        self.torque_velocity = torch.zeros(num_envs, len(layout.joint_dof), dtype=torch.float64)
        self.world_offset = torch.zeros(num_envs, 2, dtype=torch.float64)
        self.diverged = torch.zeros(num_envs, dtype=torch.bool)
        self._nominal: dict[str, Tensor] = {}
        self._substeps = 0  # since the last command
        self._make()
        self.hook = SubstepHook(self) if make_hook is None else make_hook(self)
        check_hook(self.hook, num_envs, _STATE)

    @abstractmethod
    def _make(self) -> None:
        """Create the simulations and their tensors."""

    @abstractmethod
    def _substep(self, last: bool) -> None:
        """Make one simulation step; derived quantities are of its initial state. Sensors are read after the last."""

    @abstractmethod
    def _warnings(self) -> NDArray[np.int64]:
        """Return cumulative MuJoCo warning counts, (N, kinds)."""

    @abstractmethod
    def _refresh_constants(self, rows: Tensor) -> None:
        """Recompute the constants that MuJoCo derives from :attr:`fields` (``mj_setConst``)."""

    @abstractmethod
    def _restart(self, rows: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        """Reset ``rows`` to the given state with ctrl = q0 and compute all derived quantities."""

    @abstractmethod
    def forward(self) -> None:
        """Recompute all derived quantities from the state (after it was written from outside)."""

    def step(self, targets: Tensor) -> None:
        """Make one control step: :meth:`command`, then :meth:`advance`.

        Args:
            targets: joint targets in the spec's joint order, rad, (N, 12).
        """
        self.command(targets)
        self.advance()

    def command(self, targets: Tensor) -> None:
        """Begin a control step: recentre and hand the PD controllers their targets, rad, (N, 12)."""
        self._recentre()
        self._substeps = 0
        if self._delay is None:
            self.ctrl[:, self._actuators] = targets
        else:
            self._delay.give(targets)

    def advance(self, substeps: int | None = None) -> None:
        """Make substeps of hook and simulation step, None for a control step; note which simulations diverged."""
        substeps = self.decimation if substeps is None else substeps
        warned, expected = self._warnings()[:, _DIVERGED].copy(), self.time + substeps * self.timestep
        with one_torch_thread():
            for number in range(1, substeps + 1):
                self.hook.apply(self.timestep)
                if self._delay is not None and self._substeps == self._delay.due:
                    self.ctrl[:, self._actuators] = self._delay.current
                self._substeps += 1
                if number == substeps:
                    self.torque_velocity.copy_(self.qvel[:, self._joints])
                self._substep(last=number == substeps)
        # MuJoCo's own reset also zeroes the counts: only the time reveals a second divergence in a row
        warned_anew = torch.from_numpy((self._warnings()[:, _DIVERGED] > warned).any(axis=1))
        self.diverged = warned_anew | ((self.time - expected).abs() > 0.5 * self.timestep)
        if self.diverged.any():
            self.hook.reset_diverged(self.diverged)

    def nominal(self, name: str) -> Tensor:
        """Return a field of the nominal model, float64, read-only."""
        if name not in self._nominal:
            self._nominal[name] = torch.from_numpy(np.array(_field(self.scene.model, name)))
        return self._nominal[name]

    def reset(
        self, rows: Tensor, qpos: Tensor, qvel: Tensor, write: Callable[[ModelFields], None] | None = None
    ) -> None:
        """Start new episodes: fresh parameters and state.

        Args:
            rows: which simulations, (n,) integers; the others are left exactly as they are.
            qpos: (n, nq).
            qvel: (n, nv).
            write: writes the parameters of those rows into their fields, (n, ...) each, which hold the nominal
                values; None leaves the fields as they are.
        """
        if write is not None:
            fresh = ModelFields(lambda name: torch.stack([self.nominal(name)] * len(rows)))
            write(fresh)
            for name, values in fresh.items():
                self.fields[name][rows] = values
            self._refresh_constants(rows)
        self.world_offset[rows] = 0.0
        self.diverged[rows] = False
        self._restart(rows, qpos, qvel)
        if self._delay is not None:
            self._delay.begin(rows)
        self.torque_velocity[rows] = self.qvel[rows][:, self._joints]
        self.hook.start(rows)

    def _recentre(self) -> None:
        """Move all simulations back to the origin: physics is translation invariant, floats are not."""
        if not len(self.scene.layout.origin_qpos):
            return
        offset = self.qpos[:, self._origin].clone()
        self.world_offset += offset
        for place in self._carried:
            self.qpos[:, place] -= offset

    @property
    def live_state(self) -> dict[str, Tensor]:
        """Tensors of the state, not copied; stale after the next step."""
        own = {name: getattr(self, name) for name in _STATE}
        return {**own, **({} if self._delay is None else {"targets": self._delay.queue}), **self.hook.state}

    def get_state(self) -> dict[str, Tensor]:
        """Return everything a later :meth:`set_state` needs to continue bit for bit (parameters excepted)."""
        return {name: value.clone() for name, value in self.live_state.items()}

    def set_state(self, state: dict[str, Tensor]) -> None:
        """Restore a state taken by :meth:`get_state`, on any engine.

        Raises:
            KeyError: if a field is missing.
            ValueError: if a field's shape does not fit this engine.
        """
        live = self.live_state
        for name, target in live.items():
            if name not in state:
                raise KeyError(f"the state lacks {name!r}; it needs {', '.join(live)}")
            if state[name].shape != target.shape:
                got, needed = tuple(state[name].shape), tuple(target.shape)
                raise ValueError(f"state field {name!r} has shape {got}; this engine needs {needed}")
            target.copy_(state[name])
        self.forward()
        self.torque_velocity.copy_(self.qvel[:, self._joints])
        for name, target in live.items():  # MuJoCo wrote a new warm start, and reset where a state is not finite
            target.copy_(state[name])

    @property
    @abstractmethod
    def _arguments(self) -> tuple[Any, ...]:
        """Arguments of the constructor."""

    @abstractmethod
    def set_time(self, time: Tensor) -> None:
        """Write the simulation time, s, (N,)."""

    def __getstate__(self) -> dict[str, Any]:
        """Return constructor arguments and state: MuJoCo's own objects can neither be pickled nor copied."""
        return {
            "arguments": self._arguments,
            "fields": {name: value.clone() for name, value in self.fields.items()},
            "state": self.get_state(),
            "time": self.time.clone(),
            "diverged": self.diverged.clone(),
        }

    def __setstate__(self, saved: dict[str, Any]) -> None:
        """Build the simulations anew and restore their state; sensors are of that state."""
        self.__init__(*saved["arguments"])  # type: ignore[misc]
        rows = torch.arange(self.num_envs)
        for name, value in saved["fields"].items():
            self.fields[name].copy_(value)
        self._refresh_constants(rows)
        self.hook.refresh(rows)
        self.set_state(saved["state"])
        self.set_time(saved["time"])
        self.diverged.copy_(saved["diverged"])


def _field(model: mujoco.MjModel, name: str) -> NDArray[Any]:
    value = getattr(model, name)
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{name} is no array")
    return value


def shared(array: NDArray[Any]) -> Tensor:
    """Return a tensor that shares the memory of an array, also of a read-only one."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The given NumPy array is not writable")
        return torch.from_numpy(array)

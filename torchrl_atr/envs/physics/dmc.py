"""The dm_control engine: one robot on a ``dm_control.mujoco.Physics``, the reference for the batched one."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from torchrl_atr._errors import MissingPackageError
from torchrl_atr.envs.models.floor import floor_period, floor_planes, near_origin
from torchrl_atr.envs.models.scene import STAND, Scene
from torchrl_atr.envs.physics.engine import RANDOMIZED_FIELDS, Array, Engine
from torchrl_atr.envs.profiles import Readings

try:
    from dm_control.mujoco import Physics
    from dm_control.mujoco.wrapper import MjModel
except ImportError as error:
    raise MissingPackageError("dm_control", "suite") from error


class RidingPhysics(Physics):
    """A dm_control ``Physics`` whose every step obeys the drive law, whoever calls it.

    A simulation that diverges does not raise ``PhysicsError``: MuJoCo resets it, ``engine.diverged`` says so, and the
    task ends the episode. Made by :class:`DmControlEngine`; a ``copy()`` renders but does not step.

    Attributes:
        engine: evaluates the law; set by the engine that owns this physics.
    """

    engine: DmControlEngine | None = None

    def step(self, nstep: int = 1) -> None:
        """Advances by ``nstep`` substeps, each of law, planar force and MuJoCo.

        Raises:
            RuntimeError: if no engine drives this physics.
        """
        if self.engine is None:
            raise RuntimeError(
                "this RidingPhysics has no drive law to step with; take the physics of a DmControlEngine"
            )
        self.engine.advance(nstep)

    def after_reset(self) -> None:
        """Computes all derived quantities, with the actuators on: an episode starts with ctrl = q0."""
        mujoco.mj_forward(self.model.ptr, self.data.ptr)


class DmControlEngine(Engine):
    """One robot under the common interface; its arrays are (1, n), the state's live views of dm_control's.

    Args:
        scene: the compiled scene; the engine randomises a copy of its model.
        readings: the paper's open points.

    Attributes:
        physics: the dm_control physics.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS, build_scene
        >>> scene = build_scene(ROBOTS.get("a1"), TRANSPORTERS.get("single_board_g1"))
        >>> engine = DmControlEngine(scene, Readings())
        >>> engine.step(np.array([scene.robot.q0]))
        >>> round(float(engine.physics.data.time), 3)
        0.02
    """

    def __init__(self, scene: Scene, readings: Readings) -> None:
        super().__init__(scene, 1, readings)
        self.physics: Any = RidingPhysics.from_model(MjModel(copy.copy(scene.model)))
        self.physics.engine = self
        self._model, self._data = self.physics.model.ptr, self.physics.data.ptr
        data = self._data
        self.qpos, self.qvel, self.ctrl = data.qpos[None], data.qvel[None], data.ctrl[None]
        self.qfrc_applied = data.qfrc_applied[None]
        self.warmstart = data.qacc_warmstart[None]
        self.sensordata, self.actuator_force = data.sensordata[None].copy(), data.actuator_force[None]
        self.fields = {name: getattr(self._model, name)[None] for name in RANDOMIZED_FIELDS}
        self._floor, self._period = floor_planes(scene.model), floor_period(scene.model)
        rows = np.arange(1)
        stand = scene.model.key(STAND)
        self._stand = stand.id
        self._restart(rows, stand.qpos[None], stand.qvel[None])

    @property
    def time(self) -> Array:  # type: ignore[override]  # MuJoCo's scalar has no array to view
        """See :class:`Engine`."""
        return np.array([self._data.time])

    def advance(self, substeps: int) -> None:
        """See :class:`Engine`; leaves position and velocity quantities current, as dm_control does."""
        super().advance(substeps)
        mujoco.mj_step1(self._model, self._data)

    def _substep(self, last: bool) -> None:
        mujoco.mj_step(self._model, self._data)
        self.sensordata[0] = self._data.sensordata

    def _warnings(self) -> NDArray[np.int64]:
        return self._data.warning.number[None]

    def _refresh_constants(self, rows: NDArray[np.int64]) -> None:
        mujoco.mj_setConst(self._model, self._data)

    def _recentre(self) -> None:
        super()._recentre()
        self._place_floor()

    def _place_floor(self) -> None:
        """Moves the floor under the board, backwards: whoever renders this physics sees how far it rode."""
        origin = self.scene.model.geom_pos[self._floor, :2]
        # mj_setConst notes what stands at its body's origin, and MuJoCo then looks at its place no more
        self._model.geom_sameframe[self._floor] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self._model.geom_pos[self._floor, :2] = origin - near_origin(self.odometer, self._period)

    def _restart(self, rows: NDArray[np.int64], qpos: Array, qvel: Array) -> None:
        mujoco.mj_resetDataKeyframe(self._model, self._data, self._stand)
        self.qpos[:], self.qvel[:] = qpos, qvel
        self._place_floor()
        self.forward()

    def forward(self) -> None:
        """See :class:`Engine`."""
        mujoco.mj_forward(self._model, self._data)
        self.sensordata[0] = self._data.sensordata

    @property
    def _arguments(self) -> tuple[Scene, Readings]:
        return self.scene, self.readings

    def _set_time(self, time: Array) -> None:
        self._data.time = float(time[0])

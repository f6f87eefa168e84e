"""Engine of dm_control: one robot on a ``dm_control.mujoco.Physics``, the reference for the batched one."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchrl_atr._errors import MissingPackageError
from torchrl_atr.envs.models.floor import floor_period, floor_planes, near_origin
from torchrl_atr.envs.models.scene import STAND, Scene
from torchrl_atr.envs.physics.engine import Engine, ModelFields
from torchrl_atr.envs.physics.hook import SubstepHook

try:
    from dm_control.mujoco import Physics
    from dm_control.mujoco.wrapper import MjModel
except ImportError as error:
    raise MissingPackageError("dm_control", "suite") from error


class EnginePhysics(Physics):
    """dm_control ``Physics`` whose steps are those of an engine, hook included, for any caller.

    A simulation that diverges does not raise ``PhysicsError``: MuJoCo resets it, ``engine.diverged`` says so, and the
    task ends the episode. Created by :class:`DmControlEngine`; a ``copy()`` renders but does not step.

    Attributes:
        engine: owner of this physics.
    """

    engine: DmControlEngine | None = None

    def step(self, nstep: int = 1) -> None:
        """Advance by ``nstep`` substeps, each of the engine's hook and MuJoCo.

        Raises:
            RuntimeError: if no engine drives this physics.
        """
        if self.engine is None:
            raise RuntimeError("this EnginePhysics has no engine to step with; take the physics of a DmControlEngine")
        self.engine.advance(nstep)

    def after_reset(self) -> None:
        """Compute all derived quantities, with the actuators on: an episode starts with ctrl = q0."""
        mujoco.mj_forward(self.model.ptr, self.data.ptr)


class DmControlEngine(Engine):
    """Engine of one robot; its arrays are (1, n), the state's are live views of dm_control's.

    Args:
        scene: the compiled scene; the engine randomises a copy of its model.
        make_hook: see :class:`Engine`.
        action_delay: likewise.

    Attributes:
        physics: the dm_control physics.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
        >>> scene = build_scene(ROBOTS.get("a1"), FlatGround())
        >>> engine = DmControlEngine(scene)
        >>> engine.step(torch.tensor([scene.robot.q0]))
        >>> round(float(engine.physics.data.time), 3)
        0.02
    """

    def __init__(
        self, scene: Scene, make_hook: Callable[[Engine], SubstepHook] | None = None, action_delay: float = 0.0
    ) -> None:
        super().__init__(scene, 1, make_hook, action_delay)
        self._restart(torch.arange(1), self.qpos.clone(), self.qvel.clone())

    def _make(self) -> None:
        model = self.scene.model
        self.physics: Any = EnginePhysics.from_model(MjModel(copy.copy(model)))
        self.physics.engine = self
        self._model, self._data = self.physics.model.ptr, self.physics.data.ptr
        data = self._data
        self.qpos, self.qvel, self.ctrl = _row(data.qpos), _row(data.qvel), _row(data.ctrl)
        self.qfrc_applied, self.warmstart = _row(data.qfrc_applied), _row(data.qacc_warmstart)
        self.actuator_force, self.sensordata = _row(data.actuator_force), _row(data.sensordata).clone()
        self.fields = ModelFields(lambda name: _row(getattr(self._model, name)))
        self._floor, self._period = floor_planes(model), floor_period(model)
        stand = model.key(STAND)
        self._stand = stand.id
        self.qpos[0], self.qvel[0] = torch.from_numpy(stand.qpos), torch.from_numpy(stand.qvel)

    @property
    def time(self) -> Tensor:  # type: ignore[override]  # MuJoCo's scalar has no array to view
        """Simulation time, see :class:`Engine`."""
        return torch.tensor([self._data.time], dtype=torch.float64)

    def advance(self, substeps: int | None = None) -> None:
        """Advance, see :class:`Engine`; leave position and velocity quantities current, as dm_control does."""
        super().advance(substeps)
        mujoco.mj_step1(self._model, self._data)

    def _substep(self, last: bool) -> None:
        mujoco.mj_step(self._model, self._data)
        self._read_sensors()

    def _read_sensors(self) -> None:
        self.sensordata[0] = torch.from_numpy(self._data.sensordata)

    def _warnings(self) -> NDArray[np.int64]:
        return self._data.warning.number[None]

    def _refresh_constants(self, rows: Tensor) -> None:
        mujoco.mj_setConst(self._model, self._data)

    def _recentre(self) -> None:
        super()._recentre()
        self._place_floor()

    def _place_floor(self) -> None:
        """Move the floor under the robot, backwards, so that renderings of this physics show the distance travelled."""
        origin = self.scene.model.geom_pos[self._floor, :2]
        # mj_setConst marks geoms at their body's origin, and MuJoCo then ignores their positions
        self._model.geom_sameframe[self._floor] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self._model.geom_pos[self._floor, :2] = origin - near_origin(self.world_offset.numpy(), self._period)

    def _restart(self, rows: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        mujoco.mj_resetDataKeyframe(self._model, self._data, self._stand)
        self.qpos.copy_(qpos)
        self.qvel.copy_(qvel)
        self._place_floor()
        self.forward()

    def forward(self) -> None:
        """Recompute all derived quantities, see :class:`Engine`."""
        mujoco.mj_forward(self._model, self._data)
        self._read_sensors()

    @property
    def _arguments(self) -> tuple[Any, ...]:
        return self.scene, self.make_hook, self.action_delay

    def set_time(self, time: Tensor) -> None:
        """Write the simulation time, see :class:`Engine`."""
        self._data.time = float(time[0])


def _row(array: NDArray[Any]) -> Tensor:
    """Return an array with a leading axis of one simulation, in the same memory."""
    return torch.from_numpy(array[None])

"""Batched engine: N robots on ``mujoco.batch``, each with its own parameters, on all CPUs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import mujoco
import mujoco.batch
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchrl_atr._checks import check_whole
from torchrl_atr._cpus import available_cpus
from torchrl_atr.envs.models.scene import STAND, Scene
from torchrl_atr.envs.physics.engine import Engine, ModelFields, shared
from torchrl_atr.envs.physics.hook import SubstepHook

_STATE = mujoco.mjtStage.mjSTAGE_NONE
_NO_SENSORS = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)


class BatchEngine(Engine):
    """Engine on ``mujoco.batch.Batch``; results do not depend on the number of threads.

    Args:
        scene: the compiled scene.
        num_envs: N.
        make_hook: see :class:`Engine`.
        num_threads: physics threads; None for the CPUs this process may use.
        action_delay: see :class:`Engine`.

    Raises:
        ValueError: if ``num_threads`` is below one.

    Example:
        >>> import torch
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
        >>> scene = build_scene(ROBOTS.get("a1"), FlatGround())
        >>> engine = BatchEngine(scene, num_envs=2)
        >>> engine.step(torch.tensor([scene.robot.q0] * 2))
        >>> engine.time.tolist()
        [0.02, 0.02]
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        make_hook: Callable[[Engine], SubstepHook] | None = None,
        num_threads: int | None = None,
        action_delay: float = 0.0,
    ) -> None:
        self._num_threads = check_whole("num_threads", num_threads, low=1, optional=True)
        super().__init__(scene, num_envs, make_hook, action_delay)
        stand = scene.model.key(STAND)
        self._restart(torch.arange(num_envs), torch.from_numpy(stand.qpos), torch.from_numpy(stand.qvel))

    def _make(self) -> None:
        model = self.scene.model
        self.batch = mujoco.batch.Batch(model, self.num_envs, nthread=self._num_threads or available_cpus())
        bind = self.batch.bind
        self.qpos, self.qvel, self.ctrl = shared(bind("qpos")), shared(bind("qvel")), shared(bind("ctrl"))
        self.qfrc_applied = shared(bind("qfrc_applied"))
        self.time, self.warmstart = shared(bind("time")), shared(bind("qacc_warmstart"))
        self.sensordata, self.actuator_force = shared(bind("sensordata")), shared(bind("actuator_force"))
        self.fields = ModelFields(lambda name: shared(self.batch.expand(name)))
        self._stand = model.key(STAND).id
        self._disabled = self.batch.expand("opt.disableflags")

    def _substep(self, last: bool) -> None:
        self._sense(last)  # sensors are a fourteenth of a step's cost, and only those of the last substep are read
        # a simulation that fails keeps its state and time, which marks it as diverged, while the others continue
        with contextlib.suppress(mujoco.batch.SimulationError):
            self.batch.step(nstep=1)

    def _sense(self, wanted: bool) -> None:
        """Enable or disable MuJoCo's computation of sensors."""
        if wanted:
            self._disabled &= ~_NO_SENSORS
        else:
            self._disabled |= _NO_SENSORS

    def _warnings(self) -> NDArray[np.int64]:
        return self.batch.warning[:, :, 1]

    def _refresh_constants(self, rows: Tensor) -> None:
        self.batch.set_const(rows.numpy())

    def _restart(self, rows: Tensor, qpos: Tensor, qvel: Tensor) -> None:
        self._sense(True)  # an interrupt may have left them disabled
        self.batch.reset(rows.numpy(), keyframe=self._stand, stage=_STATE)
        self.qpos[rows] = qpos
        self.qvel[rows] = qvel
        self.batch.forward(rows.numpy())

    def forward(self) -> None:
        """Recompute all derived quantities, see :class:`Engine`."""
        self._sense(True)
        self.batch.forward()

    @property
    def _arguments(self) -> tuple[Any, ...]:
        return self.scene, self.num_envs, self.make_hook, self._num_threads, self.action_delay

    def set_time(self, time: Tensor) -> None:
        """Write the simulation time, see :class:`Engine`."""
        self.time.copy_(time)

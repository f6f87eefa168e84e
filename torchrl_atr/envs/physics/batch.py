"""The batched engine: N robots on ``mujoco.batch``, each with its own parameters, on all CPUs."""

from __future__ import annotations

import contextlib

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from torchrl_atr._checks import check_whole
from torchrl_atr._cpus import available_cpus
from torchrl_atr.envs.models.scene import STAND, Scene
from torchrl_atr.envs.physics.engine import RANDOMIZED_FIELDS, Array, Engine
from torchrl_atr.envs.profiles import Readings

_STATE = mujoco.mjtStage.mjSTAGE_NONE
_NO_SENSORS = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)


class BatchEngine(Engine):
    """``mujoco.batch.Batch`` under the common interface; results do not depend on the number of threads.

    Args:
        scene: the compiled scene.
        num_envs: N.
        readings: the paper's open points.
        num_threads: physics threads; None for the CPUs this process may use.

    Raises:
        ValueError: if ``num_threads`` is below one.
    """

    def __init__(self, scene: Scene, num_envs: int, readings: Readings, num_threads: int | None = None) -> None:
        super().__init__(scene, num_envs, readings)
        threads = check_whole("num_threads", num_threads, low=1, optional=True) or available_cpus()
        self._num_threads = num_threads
        self.batch = mujoco.batch.Batch(scene.model, num_envs, nthread=threads)
        bind, expand = self.batch.bind, self.batch.expand
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self.qfrc_applied = bind("qfrc_applied")
        self.time, self.warmstart = bind("time"), bind("qacc_warmstart")
        self.sensordata, self.actuator_force = bind("sensordata"), bind("actuator_force")
        self.fields = {name: expand(name) for name in RANDOMIZED_FIELDS}
        self._stand = scene.model.key(STAND).id
        self._disabled = expand("opt.disableflags")

    def _substep(self, last: bool) -> None:
        self._sense(last)  # sensors are a fourteenth of a step, and nobody reads those of the first ones
        # a simulation that fails keeps its state and time, which marks it as diverged, while the others go on
        with contextlib.suppress(mujoco.batch.SimulationError):
            self.batch.step(nstep=1)

    def _sense(self, wanted: bool) -> None:
        """Has MuJoCo compute sensors from here on, or not."""
        if wanted:
            self._disabled &= ~_NO_SENSORS
        else:
            self._disabled |= _NO_SENSORS

    def _warnings(self) -> NDArray[np.int64]:
        return self.batch.warning[:, :, 1]

    def _refresh_constants(self, rows: NDArray[np.int64]) -> None:
        self.batch.set_const(rows)

    def _restart(self, rows: NDArray[np.int64], qpos: Array, qvel: Array) -> None:
        self._sense(True)  # an interrupt may have left them off
        self.batch.reset(rows, keyframe=self._stand, stage=_STATE)
        self.qpos[rows] = qpos
        self.qvel[rows] = qvel
        self.batch.forward(rows)

    def forward(self) -> None:
        """See :class:`Engine`."""
        self._sense(True)
        self.batch.forward()

    @property
    def _arguments(self) -> tuple[Scene, int, Readings, int | None]:
        return self.scene, self.num_envs, self.readings, self._num_threads

    def _set_time(self, time: Array) -> None:
        self.time[...] = time

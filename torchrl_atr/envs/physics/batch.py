"""The batched engine: N robots on ``mujoco.batch``, each with its own parameters, on all CPUs of the process."""

from __future__ import annotations

import os

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.physics.engine import Array, Engine, PhysicalParameters
from torchrl_atr.envs.profiles import Readings

_STATE, _FRESH = mujoco.mjtStage.mjSTAGE_NONE, mujoco.mjtStage.mjSTAGE_VEL


class BatchEngine(Engine):
    """``mujoco.batch.Batch`` under the common interface; results do not depend on the number of threads.

    Args:
        scene: the compiled scene.
        num_envs: N.
        readings: the paper's open points.
        num_threads: physics threads; None for the CPUs this process may use.
    """

    def __init__(self, scene: Scene, num_envs: int, readings: Readings, num_threads: int | None = None) -> None:
        super().__init__(scene, num_envs, readings)
        threads = num_threads or len(os.sched_getaffinity(0))
        self.batch = mujoco.batch.Batch(scene.model, num_envs, nthread=threads)
        bind, expand = self.batch.bind, self.batch.expand
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self.qfrc_applied = bind("qfrc_applied")
        self._warmstart = bind("qacc_warmstart")
        self._sensordata, self._actuator_force = bind("sensordata"), bind("actuator_force")
        self._mass, self._ipos, self._inertia = expand("body_mass"), expand("body_ipos"), expand("body_inertia")
        self._gain, self._bias = expand("actuator_gainprm"), expand("actuator_biasprm")
        self._friction = expand("geom_friction")
        self._stiffness, self._damping = expand("jnt_stiffness"), expand("dof_damping")

    @property
    def sensordata(self) -> Array:
        """See :class:`Engine`."""
        return self._sensordata

    @property
    def actuator_force(self) -> Array:
        """See :class:`Engine`."""
        return self._actuator_force

    @property
    def warmstart(self) -> Array:
        """See :class:`Engine`."""
        return self._warmstart

    def _substep(self, last: bool) -> None:
        self.batch.step(nstep=1, stage=_FRESH if last else _STATE)

    def _warnings(self) -> NDArray[np.int64]:
        return self.batch.warning[:, :, 1]

    def _write_parameters(self, rows: NDArray[np.int64], parameters: PhysicalParameters) -> None:
        model, layout = self.scene.model, self.scene.layout
        trunk, deck = layout.trunk_body, layout.deck_body
        nominal = model.body_mass[trunk]
        self._mass[rows, trunk] = nominal + parameters.payload
        self._inertia[rows, trunk] = model.body_inertia[trunk] * (1.0 + parameters.payload / nominal)[:, None]
        self._ipos[rows, trunk] = model.body_ipos[trunk] + parameters.com_shift
        self._mass[rows, deck] = parameters.platform_mass
        ratio = parameters.platform_mass / model.body_mass[deck]
        self._inertia[rows, deck] = model.body_inertia[deck] * ratio[:, None]
        cells = np.ix_(rows, layout.actuators)
        self._gain[(*cells, 0)] = parameters.kp
        self._bias[(*cells, 1)] = -parameters.kp
        self._bias[(*cells, 2)] = -parameters.kd
        self._friction[rows, layout.deck_geom, 0] = parameters.friction
        # the scene lists pitch before roll, Table II roll before pitch
        self._stiffness[np.ix_(rows, layout.tilt_joints)] = parameters.sb_stiffness[:, ::-1]
        self._damping[np.ix_(rows, layout.tilt_dof)] = parameters.sb_damping[:, ::-1]
        self.batch.set_const(rows)

    def _restart(self, rows: NDArray[np.int64], qpos: Array, qvel: Array) -> None:
        self.batch.reset(rows, keyframe=0, stage=_STATE)
        self.qpos[rows] = qpos
        self.qvel[rows] = qvel
        self.batch.forward(rows, stage=_FRESH)

    def forward(self) -> None:
        """See :class:`Engine`."""
        self.batch.forward(stage=_FRESH)

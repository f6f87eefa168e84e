"""Robot on its transporter, or on the floor, in plain MuJoCo, from a bundle's scene; no torch, nothing of our envs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchrl_atr._errors import MissingPackageError
from torchrl_atr.deploy.manifest import SCENE, BundleError, find_policy, read_manifest
from torchrl_atr.deploy.readings import GRAVITY, Imu
from torchrl_atr.deploy.robot import RobotState
from torchrl_atr.deploy.runner import JointCommand

Values = NDArray[np.float64]


def drive_law(speeds: Values, tilt: Values, transporter: Mapping[str, Any], dt: float) -> Values:
    """Return forward speed, m/s, and yaw rate, rad/s, of a transporter after ``dt``, Eqs. 1 to 3 and 7 to 10, (2,).

    Args:
        speeds: before, (2,).
        tilt: forward and steering tilt, rad, (2,).
        transporter: of a manifest.
        dt: s.
    """
    own, interpretation = transporter, transporter["interpretation"]
    smoothing, x_s = interpretation["steering_smoothing"], interpretation["coulomb_smoothing"]
    sign = np.tanh(tilt[0] / smoothing) if smoothing else np.copysign(1.0, tilt[0] + 0.0)
    share = np.clip(tilt / own["tilt_norm"], -1.0, 1.0)
    push = share * (own["max_acceleration"], -own["max_yaw_acceleration"] * sign)
    inertia = np.array([own["mass"], own["inertia_z"]])
    scale = dt * (1.0 if interpretation["relative_mass"] else 1.0 / inertia)
    c0, c1, c2 = own["resistance"]
    size = np.abs(speeds)
    magnitude = c0 + c1 * size + c2 * size**2
    if not interpretation["odd_resistance"]:
        return speeds + scale * (push - (c0 + c1 * speeds + c2 * speeds**2))
    if x_s:
        return speeds + scale * (push - magnitude * np.tanh(speeds / x_s))
    free = speeds + scale * push
    return np.sign(free) * np.maximum(np.abs(free) - scale * magnitude, 0.0)


class SimulatedRobot:
    """Robot on its transporter, or on the floor, in MuJoCo: a :class:`~torchrl_atr.deploy.Robot` with exact sensors.

    Args:
        bundle: its folder, or the name of an installed policy.

    Attributes:
        model, data: of MuJoCo.
        speeds: of the transporter, or of the trunk on the floor: forward m/s and yaw rad/s, (2,).

    Raises:
        BundleError: if the bundle is damaged, has no scene, or its transporter a drive law of its own.
        MissingPackageError: if MuJoCo is not installed.
    """

    def __init__(self, bundle: str | Path) -> None:
        try:
            import mujoco
        except ImportError:
            raise MissingPackageError("mujoco", "deploy") from None
        manifest, folder = read_manifest(bundle), find_policy(bundle)
        transporter = manifest["transporter"]
        if SCENE not in manifest["files"] or (transporter and transporter["drive"] != "tilt_drive"):
            raise BundleError(
                f"the bundle {folder} has no scene for plain MuJoCo (the robot has meshes, or the transporter a drive "
                "law of its own); ride it with `torchrl-atr play`"
            )
        self._mujoco, self._transporter = mujoco, transporter
        self._gravity, self._steps = manifest["imu"]["gravity_included"], manifest["control"]["simulation_steps"]
        self.model = model = mujoco.MjModel.from_xml_path(str(folder / SCENE))
        self.data = mujoco.MjData(model)
        joints = [model.joint(joint["name"]).id for joint in manifest["joints"]]
        self._q, self._v = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        driven = {int(joint): actuator for actuator, joint in enumerate(model.actuator_trnid[:, 0])}
        self._actuators = np.array([driven[joint] for joint in joints])
        free = int(np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0])
        self._root_q, self._root_v = int(model.jnt_qposadr[free]), int(model.jnt_dofadr[free])
        if transporter:
            self._find_transporter(transporter)
        self.reset()

    def _find_transporter(self, transporter: Mapping[str, Any]) -> None:
        model = self.model
        planar = [model.joint(name).id for name in transporter["planar_joints"]]
        self._planar_v, self._heading = model.jnt_dofadr[planar], int(model.jnt_qposadr[planar[2]])
        self._hinges = model.jnt_qposadr[[model.joint(name).id for name in transporter["hinges"]]]
        self._driving = np.array(transporter["driving"])
        own = transporter["mass"], transporter["mass"], transporter["inertia_z"]
        self._inertia = model.dof_armature[self._planar_v] + own

    def reset(self, qpos: Values | None = None) -> None:
        """Let the robot stand at rest in q0, or be at rest in another configuration, (nq,)."""
        self._mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        if qpos is not None:
            self.data.qpos[:] = qpos
        self._mujoco.mj_forward(self.model, self.data)
        self.speeds, self._acceleration = np.zeros(2), np.zeros(3)

    def read(self) -> RobotState:
        """Return exact readings."""
        qpos, qvel = self.data.qpos, self.data.qvel
        rotation = self._rotation()
        roll, pitch = np.arctan2(rotation[2, 1], rotation[2, 2]), np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0))
        acceleration = self._acceleration + (0.0, 0.0, GRAVITY if self._gravity else 0.0)
        turning = qvel[self._root_v + 3 : self._root_v + 6].copy()
        imu = Imu(rotation.T @ acceleration, turning, (float(roll), float(pitch)))
        return RobotState(self.data.time, imu, qpos[self._q].copy(), qvel[self._v].copy())

    def send(self, command: JointCommand) -> None:
        """Simulate a control period with these targets and gains."""
        self.data.ctrl[self._actuators] = command.targets
        self.model.actuator_gainprm[self._actuators, 0] = command.gains.kp
        self.model.actuator_biasprm[self._actuators, 1] = -command.gains.kp
        self.model.actuator_biasprm[self._actuators, 2] = -command.gains.kd
        velocity = self.data.qvel[self._root_v : self._root_v + 3].copy()
        for _ in range(self._steps):
            if self._transporter:
                self._drive(self.model.opt.timestep)
            self._mujoco.mj_step(self.model, self.data)
        if not self._transporter:
            ahead, turning = self._rotation()[:2, 0], self.data.qvel[self._root_v + 5]
            ahead = ahead / np.linalg.norm(ahead)
            self.speeds = np.array([ahead @ self.data.qvel[self._root_v : self._root_v + 2], turning])
        change = self.data.qvel[self._root_v : self._root_v + 3] - velocity
        self._acceleration = change / (self._steps * self.model.opt.timestep)

    @property
    def height(self) -> float:
        """Height of the trunk's origin above the floor, m."""
        return float(self.data.qpos[self._root_q + 2])

    def _drive(self, dt: float) -> None:
        """Apply the force that gives the transporter the speeds of the drive law after a step."""
        self.speeds = drive_law(self.speeds, self._driving @ self.data.qpos[self._hinges], self._transporter, dt)
        heading = self.data.qpos[self._heading] + self.speeds[1] * dt
        wanted = np.array([self.speeds[0] * np.cos(heading), self.speeds[0] * np.sin(heading), self.speeds[1]])
        self.data.qfrc_applied[self._planar_v] = self._inertia * (wanted - self.data.qvel[self._planar_v]) / dt

    def _rotation(self) -> Values:
        """Return the rotation matrix of the trunk, body to world, (3, 3)."""
        flat = np.zeros(9)
        self._mujoco.mju_quat2Mat(flat, self.data.qpos[self._root_q + 3 : self._root_q + 7])
        return flat.reshape(3, 3)

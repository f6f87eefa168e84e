"""Runtime of a policy bundle with NumPy and ONNX Runtime alone."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from torchrl_atr._errors import InputError, MissingPackageError
from torchrl_atr.deploy.manifest import POLICY, find_policy, read_manifest
from torchrl_atr.deploy.readings import (
    Array,
    Imu,
    RateCheck,
    UnitCheck,
    check_imu,
    check_joints,
    check_robot,
    check_start,
    checked,
)


class Gains(NamedTuple):
    """Gains of the joints' PD controllers, torque = kp (target - q) - kd q̇, N m/rad and N m s/rad, (12,) each."""

    kp: Array
    kd: Array


class JointCommand(NamedTuple):
    """Joint targets, rad, (12,), and the gains to follow them with."""

    targets: Array
    gains: Gains


class OnnxPolicy:
    """Policy of a bundle on ONNX Runtime for N robots; it holds their state and checks nothing.

    Args:
        folder: of the bundle.
        manifest: of it, from :func:`~torchrl_atr.deploy.read_manifest`.
        robots: N.

    Raises:
        MissingPackageError: if ONNX Runtime is not installed.
    """

    def __init__(self, folder: str | Path, manifest: Mapping[str, Any], robots: int = 1) -> None:
        try:
            import onnxruntime
        except ImportError:
            raise MissingPackageError("onnxruntime", "deploy") from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # small matrices: threads cost more
        path = str(find_policy(folder) / POLICY)
        self._session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        self._parts = manifest["policy"]["state"]
        self._outputs = list(manifest["policy"]["outputs"])
        self.state = {each["input"]: np.zeros((robots, *each["shape"]), np.float32) for each in self._parts}

    def __call__(self, start: np.ndarray, readings: Mapping[str, Array]) -> dict[str, Array]:
        """Return the outputs of one control step by name, (N, ...) each.

        Args:
            start: whether an episode begins, (N,) bool.
            readings: sensor values and command by name, (N, size) each.
        """
        given = {"start": start[:, None], **readings, **self.state}
        outputs = dict(zip(self._outputs, self._session.run(self._outputs, given)))
        self.state = {each["input"]: outputs[each["output"]] for each in self._parts}
        return outputs


class PolicyRunner:
    """Runner of a bundle's policy on one robot: readings in, joint targets and gains out, at the control rate.

    Observation history, dead reckoning and the last action are held here. The first step after :meth:`reset` begins an
    episode: the robot stands at rest in q0.

    Args:
        bundle: its folder, or the name of an installed policy.
        robot: name of the robot that it is to run on; None for no check.
        joints: names of its joints in the order of its readings; None for no check.
        strict: whether a command beyond the range is an error; otherwise it is clipped, with a warning.

    Attributes:
        manifest: of the bundle.
        command: that the last step followed, (2,): clipped, and approached at a limited rate.
        estimates: of the last step by name, SI units: the components of x_ext, and ``dead_reckoned_velocity``.

    Raises:
        BundleError: if the bundle is incomplete, changed, or of another version.
        InputError: if it is of another robot, or joints are in another order.

    Example:
        >>> runner = PolicyRunner("runs/bundle")  # doctest: +SKIP
        >>> targets, gains = runner.step(imu, q, qd, command=(1.0, 0.2))  # doctest: +SKIP
    """

    def __init__(
        self,
        bundle: str | Path,
        *,
        robot: str | None = None,
        joints: Sequence[str] | None = None,
        strict: bool = False,
    ) -> None:
        self.manifest = read_manifest(bundle)
        check_robot(self.manifest, robot, joints)
        self.strict = strict
        self._policy = OnnxPolicy(bundle, self.manifest)
        self._gains = Gains(*(self._of_joints(name) for name in ("kp", "kd")))
        period = 1.0 / self.manifest["control"]["rate_hz"]
        self._rate, self._units, self._warned = RateCheck(period), UnitCheck(period), False
        self.reset()

    def reset(self) -> None:
        """Begin an episode with the next step."""
        self._start = True
        self._rate.reset()
        self._units.reset()
        self.command: Array = np.zeros(len(self.manifest["command"]["names"]), np.float32)
        self.estimates: dict[str, Array] = {}

    def step(
        self,
        imu: Imu | Sequence[ArrayLike],
        joint_positions: ArrayLike,
        joint_velocities: ArrayLike,
        command: ArrayLike,
        time: float | None = None,
    ) -> JointCommand:
        """Return joint targets and gains for the next control period.

        Args:
            imu: reading of the IMU, an :class:`~torchrl_atr.deploy.Imu`.
            joint_positions: rad, (12,), in the order of the manifest's joints.
            joint_velocities: rad/s, (12,).
            command: forward speed, m/s, and yaw rate, rad/s.
            time: of the readings, s; None for no check of the control rate.

        Raises:
            InputError: for a reading of another shape, that is not finite or in another unit, a rate other than the
                manifest's, or, if ``strict``, a command beyond the range. The state is then as before the step.
        """
        readings = self._checked(imu, joint_positions, joint_velocities, command)
        before, batch = self._policy.state, {name: value[None] for name, value in readings.items()}
        checks = copy(self._rate), copy(self._units)
        outputs = {name: value[0] for name, value in self._policy(np.array([self._start]), batch).items()}
        try:
            self._check_range(readings["command"], outputs["command_in_range"])
            self._units.check(readings, readings["joint_position"], readings["joint_velocity"])
            if time is not None:
                self._rate.check(time)
        except InputError:  # the same readings and time may be given again
            self._policy.state, (self._rate, self._units) = before, checks
            raise
        self._start, self.command = False, outputs["command_in_force"]
        self.estimates = self._named(outputs)
        return JointCommand(outputs["joint_targets"], self._gains)

    def damping(self) -> JointCommand:
        """Return a command that only damps the joints, by the policy's kd: for a robot that has to be stopped."""
        kp, kd = self._gains
        return JointCommand(self._of_joints("q0"), Gains(np.zeros_like(kp), kd))

    def _checked(self, imu: Any, positions: ArrayLike, velocities: ArrayLike, command: ArrayLike) -> dict[str, Array]:
        try:
            given = dict(zip(("acceleration", "angular_velocity", "orientation"), imu, strict=True))
        except (TypeError, ValueError):
            raise InputError(
                "imu: give Imu(acceleration, angular_velocity, orientation), in m/s², rad/s and rad"
            ) from None
        given |= {"joint_position": positions, "joint_velocity": velocities}
        readings = {
            each["name"]: checked(each["argument"], given[each["name"]], each["size"], each["unit"])
            for each in self.manifest["sensors"]
        }
        names, units = self.manifest["command"]["names"], self.manifest["command"]["units"]
        readings["command"] = checked("command", command, len(names), ", ".join(units))
        check_imu(readings)
        check_joints(self.manifest, readings["joint_position"], readings["joint_velocity"])
        if self._start:
            check_start(self.manifest, readings, readings["joint_position"])
        return readings

    def _check_range(self, asked: Array, followed: Array) -> None:
        if np.allclose(asked, followed, atol=1e-6):
            return
        own = self.manifest["command"]
        text = (
            f"the command {_pair(asked)} is beyond the range of {self.manifest['name']!r} ({own['clipping']}); "
            f"{_pair(followed)} is followed instead: ask for no more than that"
        )
        if self.strict:
            raise InputError(text)
        if not self._warned:
            self._warned = True
            warnings.warn(text, stacklevel=3)

    def _named(self, outputs: Mapping[str, Array]) -> dict[str, Array]:
        named, first = {}, 0
        for each in self.manifest["estimates"]:
            named[each["name"]] = outputs["extrinsic"][first : first + each["size"]]
            first += each["size"]
        return {**named, "dead_reckoned_velocity": outputs["dead_reckoned_velocity"]}

    def _of_joints(self, name: str) -> Array:
        return np.array([joint[name] for joint in self.manifest["joints"]], np.float32)


def _pair(command: Array) -> str:
    return f"({', '.join(f'{value:.3g}' for value in command)})"

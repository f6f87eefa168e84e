"""Sensor readings of a robot, and their checks: shapes, NaN, units, order of joints; without torch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from torchrl_atr._errors import InputError

Array = NDArray[np.float32]
GRAVITY = 9.81
RATE_TOLERANCE, RATE_STEPS = 0.1, 50
"""Relative error of the mean control period that is refused, and the number of periods that it is the mean of."""
FASTEST_JOINT, FASTEST_TURN = 60.0, 40.0
"""Speeds beyond those of any quadruped's joints, and of its IMU's range, rad/s: larger numbers are degrees."""
FROM_STANCE = 0.6
"""Largest difference of a joint from q0 at the start of an episode, rad: more is another order, sign or zero."""
BEYOND_RANGE = 0.5
"""Largest excess of a joint over its range, rad."""
STANDING_TILT = 0.5
"""Largest roll or pitch at the start of an episode, rad."""
_VISIBLE = 5.0
"""Mean rate that is no noise, rad/s: 0.1 rad/s in degrees."""
UNIT_STEPS, UNIT_RATIO = 50, 10.0
"""Control steps over which rates are compared with the changes of angles, and the ratio from which the units differ."""


class Imu(NamedTuple):
    """Reading of an IMU in the body frame: x forward, y left, z up.

    Attributes:
        acceleration: m/s², (3,); the manifest says whether gravity's reaction is part of it, see
            :func:`without_gravity`.
        angular_velocity: rad/s, (3,).
        orientation: roll and pitch of R = Rz(yaw) Ry(pitch) Rx(roll), rad, (2,).
    """

    acceleration: ArrayLike
    angular_velocity: ArrayLike
    orientation: ArrayLike


class RateCheck:
    """Check that control steps come at their period, on average: a late one alone is no error.

    Args:
        period: s.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.reset()

    def reset(self) -> None:
        """Forget the times before."""
        self._times: list[float] = []

    def check(self, time: float) -> None:
        """Note the time of a step, s.

        Raises:
            InputError: if it does not follow the last one, or the mean of the last :data:`RATE_STEPS` periods is
                another than it should be by more than :data:`RATE_TOLERANCE`.
        """
        if not math.isfinite(time) or (self._times and time <= self._times[-1]):
            raise InputError(f"time={time!r} does not follow that of the last step; give seconds of a steady clock")
        self._times = [*self._times, float(time)][-RATE_STEPS - 1 :]
        mean = (self._times[-1] - self._times[0]) / RATE_STEPS
        if len(self._times) > RATE_STEPS and abs(mean / self.period - 1.0) > RATE_TOLERANCE:
            raise InputError(
                f"the last {RATE_STEPS} steps came every {1e3 * mean:.1f} ms; call step() every "
                f"{1e3 * self.period:.0f} ms, at {1.0 / self.period:g} Hz, with the time in seconds"
            )


class UnitCheck:
    """Check that rates are those of the angles: one reading may be degrees that look like radians, a second's are not.

    Args:
        period: of the control steps, s.

    Example:
        >>> units, still = UnitCheck(0.02), np.zeros(12, np.float32)
        >>> units.check({"orientation": still[:2], "angular_velocity": still[:3]}, still, still)
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.reset()

    def reset(self) -> None:
        """Forget the readings before."""
        self._before: tuple[Array, Array] | None = None
        self._squares: list[tuple[float, ...]] = []

    def check(self, imu: Mapping[str, Array], position: Array, velocity: Array) -> None:
        """Note a reading, and compare those of the last second.

        Raises:
            InputError: names angles and rates of which one is in degrees.
        """
        before, self._before = self._before, (imu["orientation"], position)
        if before is None:
            return
        turn, moved = ((now - then) / self.period for now, then in zip(self._before, before))
        rates = turn, imu["angular_velocity"][:2], moved, velocity
        self._squares = [*self._squares, tuple(float(np.square(rate).mean()) for rate in rates)][-UNIT_STEPS:]
        if len(self._squares) < UNIT_STEPS:
            return
        turning, gyro, moving, fast = np.sqrt(np.mean(self._squares, axis=0))
        _compare_rates("imu.orientation", turning, "imu.angular_velocity", gyro)
        _compare_rates("joint_positions", moving, "joint_velocities", fast)


def _compare_rates(angle: str, change: float, name: str, rate: float) -> None:
    """Raise an InputError if one of two rates, rad/s, is so much larger that it can only be in degrees."""
    if rate > max(_VISIBLE, UNIT_RATIO * change):
        raise InputError(f"{name} is {rate / max(change, 1e-9):.0f} times the change of {angle}: degrees? give rad/s")
    if change > max(_VISIBLE, UNIT_RATIO * rate):
        raise InputError(
            f"{angle} changes {change / max(rate, 1e-9):.0f} times as fast as {name}: degrees? give radians"
        )


def without_gravity(specific_force: ArrayLike, roll: float, pitch: float) -> NDArray[np.float64]:
    """Return the acceleration of a body, (3,), from the specific force that an accelerometer measures; m/s².

    Example:
        >>> without_gravity((0.0, 0.0, 9.81), roll=0.0, pitch=0.0).tolist()
        [0.0, 0.0, 0.0]
    """
    up = (-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll))
    return np.asarray(specific_force, dtype=np.float64) - GRAVITY * np.array(up)


def checked(name: str, value: ArrayLike, size: int, unit: str) -> Array:
    """Return a reading as float32, (size,).

    Raises:
        InputError: if it has another shape, or a number that is not finite.

    Example:
        >>> checked("command", [1.0, 0.2], 2, "m/s, rad/s").dtype
        dtype('float32')
    """
    try:
        array = np.asarray(value, dtype=np.float32)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {type(value).__name__}, no numbers; give {size} in {unit}") from None
    if array.shape != (size,):
        raise InputError(f"{name} has shape {array.shape}; give ({size},), in {unit}, of one robot")
    bad = np.flatnonzero(~np.isfinite(array))
    if len(bad):
        raise InputError(
            f"{name}[{bad[0]}] is {array[bad[0]]}; do not command the robot by it: stop, and call reset() when its "
            "sensors work"
        )
    return array


def check_joints(manifest: Mapping[str, Any], position: Array, velocity: Array) -> None:
    """Check joint positions and velocities, (12,) each, against the ranges of the joints.

    Raises:
        InputError: names the joint, and degrees if these they seem to be.
    """
    joints = manifest["joints"]
    low, high = (np.array([joint["range"][end] for joint in joints]) for end in (0, 1))
    excess = np.maximum(low - position, position - high)
    worst = int(np.argmax(excess))
    if excess[worst] > BEYOND_RANGE:
        name, value = joints[worst]["name"], position[worst]
        span = f"its range is {low[worst]:.2f} to {high[worst]:.2f} rad"
        if np.max(np.maximum(low - np.radians(position), np.radians(position) - high)) <= BEYOND_RANGE:
            raise InputError(f"joint_positions: {name} is {value:.1f}, {span}: degrees? give radians")
        order = "check the order, signs and zeros of the joints: " + _names(manifest)
        raise InputError(f"joint_positions: {name} is {value:.2f} rad, {span}; {order}")
    _check_speed("joint_velocities", velocity, FASTEST_JOINT)


def check_imu(imu: Mapping[str, Array]) -> None:
    """Check the units of an IMU's reading, by the names of :class:`Imu`.

    Raises:
        InputError: for angles or rates that can only be degrees.
    """
    _check_speed("imu.angular_velocity", imu["angular_velocity"], FASTEST_TURN)
    tilt = float(np.abs(imu["orientation"]).max())
    if tilt > math.pi:
        raise InputError(f"imu.orientation holds {tilt:.1f}: degrees? give roll and pitch in rad")


def check_start(manifest: Mapping[str, Any], imu: Mapping[str, Array], position: Array) -> None:
    """Check the first reading of an episode, in which the robot stands at rest in q0.

    Raises:
        InputError: if a joint is far from q0, or gravity is in the acceleration and should not be, or the reverse.
    """
    joints = manifest["joints"]
    off = position - np.array([joint["q0"] for joint in joints])
    worst = int(np.argmax(np.abs(off)))
    if abs(off[worst]) > FROM_STANCE:
        raise InputError(
            f"joint_positions: {joints[worst]['name']} is {off[worst]:+.2f} rad off q0 at the start of an episode; let "
            f"the robot stand in q0 first, and check order, signs and zeros of the joints: {_names(manifest)}"
        )
    tilt = float(np.abs(imu["orientation"]).max())
    if tilt > STANDING_TILT:
        raise InputError(
            f"imu.orientation holds {tilt:.2f} at the start of an episode, in which the robot stands on level boards: "
            "degrees, or mounted at an angle? give roll and pitch of the body in rad, and let the robot stand first"
        )
    up = -without_gravity((0.0, 0.0, 0.0), *(float(angle) for angle in imu["orientation"])) / GRAVITY
    included = bool(manifest["imu"]["gravity_included"])
    if (float(imu["acceleration"] @ up) > 0.5 * GRAVITY) is not included:
        measured = f"imu.acceleration is {float(imu['acceleration'] @ up):.1f} m/s² upwards in a robot at rest"
        wanted = "give the specific force, gravity's reaction included" if included else "subtract gravity's reaction"
        raise InputError(f"{measured}; {wanted} (torchrl_atr.deploy.without_gravity is the difference)")


def check_robot(manifest: Mapping[str, Any], robot: str | None, joints: Sequence[str] | None) -> None:
    """Check that a bundle is of this robot, and joints are in its order.

    Args:
        manifest: of the bundle.
        robot: name of the robot; None for no check.
        joints: names of its joints in the order of its readings; None for no check.

    Raises:
        InputError: if not.
    """
    own = [joint["name"] for joint in manifest["joints"]]
    if robot is not None and robot != manifest["robot"]["name"]:
        raise InputError(
            f"the bundle {manifest['name']!r} is of the robot {manifest['robot']['name']!r}, not {robot!r}; take a "
            "bundle of that robot"
        )
    if joints is None or list(joints) == own:
        return
    if sorted(joints) == sorted(own):
        permutation = [list(joints).index(name) for name in own]
        raise InputError(
            f"joints are in another order than in the bundle {manifest['name']!r}; reorder readings by "
            f"values[{permutation}], and targets back"
        )
    strange = next(name for name in [*joints, *own] if name not in own or name not in joints)
    raise InputError(f"joints: {strange!r} is not in both; the joints of {manifest['name']!r} are {_names(manifest)}")


def _names(manifest: Mapping[str, Any]) -> str:
    return ", ".join(joint["name"] for joint in manifest["joints"])


def _check_speed(name: str, value: Array, largest: float) -> None:
    worst = float(np.abs(value).max())
    if worst > largest:
        raise InputError(f"{name} holds {worst:.1f}, more than {largest:g} rad/s: degrees per second? give rad/s")

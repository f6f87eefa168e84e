"""Interface of a robot that a policy runs on: two methods."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from numpy.typing import ArrayLike

from torchrl_atr.deploy.readings import Imu
from torchrl_atr.deploy.runner import JointCommand, PolicyRunner


class RobotState(NamedTuple):
    """Reading of a robot's sensors.

    Attributes:
        time: of a steady clock, s.
        imu: reading of the IMU.
        joint_positions: rad, (12,), in the order of the bundle's joints.
        joint_velocities: rad/s, (12,).
    """

    time: float
    imu: Imu
    joint_positions: ArrayLike
    joint_velocities: ArrayLike


class Robot(Protocol):
    """Robot that a policy runs on."""

    def read(self) -> RobotState:
        """Return the latest readings."""
        ...

    def send(self, command: JointCommand) -> None:
        """Send joint targets and gains, which hold for a control period; return when that is over."""
        ...


def run_policy(
    runner: PolicyRunner,
    robot: Robot,
    command: Callable[[float], ArrayLike],
    seconds: float,
    watch: Callable[[RobotState], None] | None = None,
) -> None:
    """Run an episode: read, step, send, at the robot's pace.

    If anything fails, an interrupt included, the robot is sent a command that only damps its joints.

    Args:
        runner: of a bundle.
        robot: that stands at rest in q0.
        command: forward speed, m/s, and yaw rate, rad/s, as a function of the time since the start, s.
        seconds: duration.
        watch: called with each reading.

    Raises:
        InputError: see :meth:`PolicyRunner.step`.
    """
    runner.reset()
    rate = runner.manifest["control"]["rate_hz"]
    try:
        for step in range(round(seconds * rate)):
            state = robot.read()
            if watch is not None:
                watch(state)
            robot.send(runner.step(*state[1:], command(step / rate), time=state.time))
    except BaseException:
        robot.send(runner.damping())
        raise

"""Custom robots: a :class:`RobotSpec` in a TOML file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torchrl_atr.envs.models.robot import ROBOTS, RobotError, RobotSpec
from torchrl_atr.envs.models.spec_file import is_spec_file, read_spec


def get_robot(robot: str | Path | RobotSpec) -> RobotSpec:
    """Return the spec of a robot given by name, by file or as a spec.

    Args:
        robot: name of a registered robot, path of a ``.toml`` file (see :func:`read_robot`), or a spec of your own.

    Raises:
        UnknownNameError: for an unknown name.
        RobotError: for a file that does not describe a robot.

    Example:
        >>> get_robot("a1").group
        'G1'
    """
    if isinstance(robot, RobotSpec):
        return robot
    return read_robot(robot) if is_spec_file(robot) else ROBOTS.get(str(robot))


def describe_robot(robot: str | Path | RobotSpec) -> str:
    """Return the argument from which :func:`get_robot` makes the same robot: a registered name, or a path."""
    return robot.name if isinstance(robot, RobotSpec) else str(robot)


def read_robot(path: str | Path) -> RobotSpec:
    """Read a robot from a TOML file, whose keys are the fields of :class:`RobotSpec`.

    Args:
        path: of the file; ``mjcf`` in it is relative to its folder.

    Returns:
        The spec; it is checked against the MJCF file when a scene is built from it.

    Raises:
        RobotError: if the file is missing, malformed, lacks a key, has one too many, or holds an impossible value.

    Example:
        >>> read_robot("nowhere.toml")
        Traceback (most recent call last):
        ...
        torchrl_atr.envs.models.robot.RobotError: there is no robot file nowhere.toml; check its path
    """
    return read_spec(path, RobotSpec, "robot", RobotError, _convert)


def _convert(values: dict[str, Any], folder: Path) -> None:
    if isinstance(values["mjcf"], str):
        values["mjcf"] = folder / values["mjcf"]

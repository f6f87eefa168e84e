"""Robots of one's own: a :class:`RobotSpec` written down in a TOML file."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

from torchrl_atr._registry import nearest
from torchrl_atr.envs.models.robot import ROBOTS, RobotError, RobotSpec

SUFFIX = ".toml"


def get_robot(robot: str | Path | RobotSpec) -> RobotSpec:
    """The robot that is meant, wherever one can be chosen.

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
    return read_robot(robot) if is_robot_file(robot) else ROBOTS.get(str(robot))


def is_robot_file(robot: str | Path) -> bool:
    """Whether a robot is given by a file rather than by name."""
    return str(robot).endswith(SUFFIX)


def read_robot(path: str | Path) -> RobotSpec:
    """A robot described by a TOML file, whose keys are the fields of :class:`RobotSpec`.

    Args:
        path: of the file; ``mjcf`` in it is relative to its folder.

    Returns:
        The spec; what it says of the MJCF file is checked when a scene is built from it.

    Raises:
        RobotError: if the file is missing, malformed, lacks a key, has one too many, or holds an impossible value.

    Example:
        >>> read_robot("nowhere.toml")
        Traceback (most recent call last):
        ...
        torchrl_atr.envs.models.robot.RobotError: there is no robot file nowhere.toml; check its path
    """
    path = Path(path)
    if not path.is_file():
        raise RobotError(f"there is no robot file {path}; check its path")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RobotError(f"{path} is not valid TOML: {error}") from error
    known = [field.name for field in dataclasses.fields(RobotSpec)]
    for key in values:
        if key not in known:
            raise RobotError(f"{path}: unknown key {key!r}; {nearest(key, known)}")
    missing = [key for key in known if key not in values]
    if missing:
        raise RobotError(f"{path}: there is no {', '.join(missing)}; a robot needs {', '.join(known)}")
    if isinstance(values["mjcf"], str):
        values["mjcf"] = path.resolve().parent / values["mjcf"]
    try:
        return RobotSpec(**values)
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from error

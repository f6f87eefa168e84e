"""Robots: an MJCF file plus the data about it that a task needs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchrl_atr._errors import UserError
from torchrl_atr._registry import Registry
from torchrl_atr.envs.models.spec_file import check_list, check_positive, check_text

_MODELS = Path(__file__).parent / "robots"

LEGS = ("FR", "RR", "FL", "RL")
"""Legs in the order of the paper's two-board equations (right first), used everywhere outside the MJCF."""
JOINTS_PER_LEG = 3
"""Abduction, thigh, calf: the order within a leg, from the trunk to the foot."""
GROUPS = ("G1", "G2")


class RobotError(UserError, ValueError):
    """Error of a robot that cannot be used as described; the message names the cause and the remedy."""


@dataclass(frozen=True)
class RobotSpec:
    """Spec of a robot: the data that a task needs beyond its MJCF file.

    Joints and feet are listed leg by leg in the order of :data:`LEGS`, three joints a leg (abduction, thigh, calf); the
    MJCF file may order and name them as it likes, since every address is looked up by name. The robot faces along x.

    Attributes:
        name: its name in messages and models.
        mjcf: path of the MJCF file. Its actuators, sensors and keyframes are replaced by the scene's own.
        trunk: name of the root body, which carries a free joint.
        joints: names of the twelve leg hinges; each is driven by one position actuator.
        feet: for each leg the name of a geom of its foot, which stands for the colliding geoms beside it too (see
            :func:`~torchrl_atr.envs.models.feet.find_feet`), or a list that names all geoms of the foot.
        q0: nominal standing joint angles, rad, in the order of ``joints``.
        kp: nominal PD stiffness of every joint, N m/rad (Table II randomises it as a ratio).
        kd: nominal PD damping, N m s/rad; the joints' own damping and friction in the MJCF come on top.
        torque_limits: of abduction, thigh and calf, N m.
        action_scale: joint displacement for a unit action, rad.
        standing_height: h_des of the trunk's origin above the support's surface, m (reward r7).
        min_height: height of the trunk's origin above the support's surface below which the robot has fallen, m.
        group: size class of Table IV, ``"G1"`` or ``"G2"``; transporters are sized for one.

    Raises:
        RobotError: for a wrong number of joints, feet or angles, a name given twice, or an impossible value.
    """

    name: str
    mjcf: Path
    trunk: str
    joints: tuple[str, ...]
    feet: tuple[str | tuple[str, ...], ...]
    q0: tuple[float, ...]
    kp: float
    kd: float
    torque_limits: tuple[float, ...]
    action_scale: float
    standing_height: float
    min_height: float
    group: str

    def __post_init__(self) -> None:
        check_text(self, "name", "trunk", "group")
        if not isinstance(self.mjcf, str | Path):
            raise self.error(f"mjcf={self.mjcf!r} is not a path; give that of the MJCF file")
        object.__setattr__(self, "mjcf", Path(self.mjcf))
        joints = len(LEGS) * JOINTS_PER_LEG
        check_list(self, "joints", str, joints, f"name {JOINTS_PER_LEG} hinges for each of {', '.join(LEGS)}")
        _check_feet(self)
        check_list(self, "q0", float, joints, "give one angle in rad for each joint")
        check_list(self, "torque_limits", float, JOINTS_PER_LEG, "give those of abduction, thigh and calf in N m")
        for angle, joint in zip(self.q0, self.joints):
            if abs(angle) > 2 * math.pi:
                raise self.error(f"q0 of joint {joint!r} is {angle:g}: degrees? give radians")
        for limit in self.torque_limits:
            check_positive(self, "torque_limits", limit)
        for name in ("kp", "kd", "action_scale", "standing_height", "min_height"):
            check_positive(self, name, getattr(self, name))
        if self.min_height >= self.standing_height:
            raise self.error(
                f"min_height={self.min_height:g} must be below standing_height={self.standing_height:g}: "
                "it is where the robot counts as fallen"
            )
        if self.group not in GROUPS:
            raise self.error(f"group={self.group!r} is unknown; choose one of {', '.join(GROUPS)}")

    @property
    def foot_names(self) -> tuple[tuple[str, ...], ...]:
        """Names of the geoms that ``feet`` gives for each leg."""
        return tuple((foot,) if isinstance(foot, str) else foot for foot in self.feet)

    def error(self, message: str) -> RobotError:
        """Return a :class:`RobotError` that names the robot."""
        return RobotError(f"robot {self.name!r}: {message}")


def _check_feet(robot: RobotSpec) -> None:
    """Check the feet and make them a tuple of names, or of tuples of names."""
    remedy = f"name one geom, or a list of all geoms of the foot, for each of {', '.join(LEGS)}"
    if not isinstance(robot.feet, Sequence) or isinstance(robot.feet, str):
        raise robot.error(f"feet={robot.feet!r} is not a list; {remedy}")
    feet = tuple(tuple(foot) if isinstance(foot, list) else foot for foot in robot.feet)
    for foot in feet:
        names = foot if isinstance(foot, tuple) else (foot,)
        if not names or not all(isinstance(name, str) and name for name in names):
            raise robot.error(f"feet holds {foot!r}; {remedy}")
    if len(feet) != len(LEGS):
        raise robot.error(f"feet has {len(feet)} entries instead of {len(LEGS)}; {remedy}")
    object.__setattr__(robot, "feet", feet)
    listed = [name for foot in robot.foot_names for name in foot]
    twice = [name for name in listed if listed.count(name) > 1]
    if twice:
        raise robot.error(f"feet lists {twice[0]!r} twice; {remedy}")


ROBOTS: Registry[RobotSpec] = Registry("robot", hint="or a .toml file that describes one")
"""Robots by name."""


def register_robot(name: str, spec: RobotSpec) -> RobotSpec:
    """Register a robot by name, for all functions that accept a robot's name.

    Args:
        name: to register it under; becomes the spec's ``name``.
        spec: the robot.

    Returns:
        The registered spec.

    Raises:
        ValueError: if ``name`` is taken.

    Example:
        >>> import dataclasses
        >>> stiff = register_robot("stiff_a1", dataclasses.replace(ROBOTS.get("a1"), kp=60.0))
        >>> ROBOTS.get("stiff_a1").kp
        60.0
    """
    return ROBOTS.register(name, dataclasses.replace(spec, name=name))


def _ship(name: str, *, legs: Sequence[str], joint: str, parts: Sequence[str], **facts: Any) -> None:
    """Register a robot of this package; ``legs`` and ``parts`` are its maker's names in the order of :data:`LEGS`."""
    spec = RobotSpec(
        name=name,
        mjcf=_MODELS / f"{name}.xml",
        joints=tuple(joint.format(leg, part) for leg in legs for part in parts),
        feet=tuple(f"{leg}_foot" for leg in legs),
        action_scale=0.25,
        **facts,
    )
    register_robot(name, spec)


# Poses: question A35. Gains: A13, for the heavy G2 robots scaled with their mass. Heights: where the robot settles.
_UNITREE: dict[str, Any] = {
    "trunk": "trunk",
    "legs": LEGS,
    "joint": "{}_{}_joint",
    "parts": ("hip", "thigh", "calf"),
    "q0": (-0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 0.8, -1.5, 0.1, 1.0, -1.5),
}
_SMALL: dict[str, Any] = {"kp": 40.0, "kd": 1.0, "group": "G1"}
_LARGE: dict[str, Any] = {"kp": 150.0, "kd": 4.5, "group": "G2"}
_ship("a1", **_UNITREE, **_SMALL, torque_limits=(33.5, 33.5, 33.5), standing_height=0.28, min_height=0.14)
_ship("go1", **_UNITREE, **_SMALL, torque_limits=(23.7, 23.7, 35.55), standing_height=0.30, min_height=0.15)
_ship(
    "anymal_c",
    **_LARGE,
    trunk="base",
    legs=("RF", "RH", "LF", "LH"),
    joint="{}_{}",
    parts=("HAA", "HFE", "KFE"),
    q0=(0.0, 0.4, -0.8, 0.0, -0.4, 0.8, 0.0, 0.4, -0.8, 0.0, -0.4, 0.8),  # hind knees bend the other way
    torque_limits=(80.0, 80.0, 80.0),
    standing_height=0.53,
    min_height=0.26,
)
_ship(
    "spot",
    **_LARGE,
    trunk="body",
    legs=("fr", "hr", "fl", "hl"),
    joint="{}_{}",
    parts=("hx", "hy", "kn"),
    q0=(-0.1, 0.9, -1.5, -0.1, 1.1, -1.5, 0.1, 0.9, -1.5, 0.1, 1.1, -1.5),
    torque_limits=(45.0, 45.0, 115.0),
    standing_height=0.49,
    min_height=0.24,
)

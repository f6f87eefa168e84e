"""The paper's ambiguous points as config values: one field per reading, three named profiles.

Numbers A1 ... A34 are those of the project's reading of the paper; ``torchrl-atr list profiles`` prints them all.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from torchrl_atr._errors import UserError
from torchrl_atr._registry import Registry, unknown


class ReadingError(UserError, ValueError):
    """A reading with an impossible value; the message names it and the range."""


@dataclass(frozen=True)
class Point:
    """A point that the paper leaves open or contradicts itself on.

    Attributes:
        number: in the project's list, such as ``"A9"``.
        why: what the paper says and why it is read as it is by default, in two lines.
        literal, ancestor: the values in those profiles; None for the default's.
        low, high: range of a number.
    """

    number: str
    why: str
    literal: Any = None
    ancestor: Any = None
    low: float = -math.inf
    high: float = math.inf


def _reading(default: Any, number: str, why: str, **values: Any) -> Any:
    return dataclasses.field(default=default, metadata={"point": Point(number, why, **values)})


@dataclass(frozen=True)
class Readings:
    """How the env reads the paper where it is silent or contradicts itself; :func:`points` says what each field is.

    Attributes:
        relative_mass: divide drive and resistance by the mass relative to its nominal, not by the mass.
        odd_resistance: R(x) acts against the motion.
        coulomb_smoothing: speed x_s (m/s or rad/s) over which R grows from zero, tanh(x / x_s); 0 keeps the jump of
            sgn(x), which may stop the motion within a step but never reverse it.
        steering_smoothing: pitch ε (rad) over which sgn(θ_y) in Eq. 3 changes sign, tanh(θ_y / ε); 0 as printed.
        sb_gains_per_degree: Table II's self-balancing gains are in N m/deg, not N m/rad.
        scaled_springs: the springs of the large (G2) transporters are five times Table II's.
        gains_as_ratios: Table II's PD gains are ranges of ratios to a nominal of each robot, not 36-44 for all.
        relative_pose: x_ext holds the relative pose.
        rewards_times_dt: multiply every reward by the control period.
        positive_rewards: clip the summed reward (termination excepted) at zero.
        current_in_history: the estimators' history ends with o_t instead of o_{t-1}.
        gravity_in_acceleration: v̇_B is the specific force of an IMU, not the kinematic acceleration.
        driven_smoothness: r8 takes the accelerations that the drive gives, without centripetal, roll's and pitch's.
        contacting_polygon: r4's and r5's polygon is of the feet in contact; with fewer than three all is outside.
        tilt_limit: body roll or pitch (rad) beyond which the episode ends.

    Raises:
        ReadingError: for a value out of range.
    """

    relative_mass: bool = _reading(
        True,
        "A9",
        "Printed, Eqs. 1 and 3 peak at 12 / 11.5 = 1.04 m/s² although the text says 12 m/s² at 45 degrees.\n"
        "Relative to the nominal mass both hold, and the board catches a leaning rider as a Segway does.",
        literal=False,
    )
    odd_resistance: bool = _reading(
        True,
        "A10",
        "R(x) = 0.2 + 0.05 x + 0.005 x² is not odd: at x < 0 its constant would push.\n"
        "A resistance acts against the motion.",
        literal=False,
    )
    coulomb_smoothing: float = _reading(
        0.5,
        "A10",
        "With a jump of the constant 0.2 at rest, no lean below 3 degrees of roll turns anything:\n"
        "learning sees no slope. Growing over 0.5 m/s (rad/s) the resistance hides nothing.",
        literal=0.0,
        ancestor=0.0,
        low=0.0,
        high=10.0,
    )
    steering_smoothing: float = _reading(
        0.0,
        "A11",
        "Eq. 3's sgn(θ_y) flips the yaw where the pitch crosses zero.\n"
        "Kept as printed; a tanh over some pitch is smooth.",
        low=0.0,
        high=math.pi / 2,
    )
    sb_gains_per_degree: bool = _reading(
        True,
        "A12",
        "Table II prints the self-balancing gains without a unit. In N m/rad, an A1 standing\n"
        "1 cm off centre would tilt the board by 66 degrees; in N m/deg it tilts by one.",
        literal=False,
    )
    scaled_springs: bool = _reading(
        True,
        "A12",
        "Table II's springs fit the small (G1) robots; ANYmal-C and Spot need 4.6 to 6.3 times as much\n"
        "for the same k_SB over m g h, so the large (G2) boards carry five times the printed gains.",
        literal=False,
    )
    gains_as_ratios: bool = _reading(
        True,
        "A13",
        "Table II gives every robot PD gains of 36-44 and 0.8-1.2; Spot collapses on them.\n"
        "Read as ±10 % and ±20 % of a nominal of each robot: 40 and 1 for A1 and Go1, 150 and 4.5 for the others.",
        literal=False,
    )
    relative_pose: bool = _reading(
        True,
        "A1",
        "Table I gives x_ext 13 components, the text lists 16 and Table V shows 16.\n"
        "Thirteen is the list without the relative pose.",
        literal=False,
    )
    rewards_times_dt: bool = _reading(
        True,
        "A16",
        "Not stated whether rewards are multiplied by the control period.\nAll ancestors do.",
        literal=False,
    )
    positive_rewards: bool = _reading(
        False,
        "A17",
        "The ancestors clip the summed reward at zero; the paper does not mention it.\n"
        "Clipping erases most penalties, of a fall above all.",
        ancestor=True,
    )
    gravity_in_acceleration: bool = _reading(
        False,
        "A18",
        "v̇_B is written as a kinematic acceleration; an IMU measures it plus gravity's reaction.\n"
        "Roll and pitch are observed beside it, so either can be had from the other.",
        ancestor=True,
    )
    current_in_history: bool = _reading(
        False,
        "A19",
        "The history is printed as o_{t-1} ... o_{t-H}, so estimates lag by one step, 20 ms.\n"
        "The ancestors leave o_t out as well; with it, estimates are of the present.",
    )
    contacting_polygon: bool = _reading(
        False,
        "A31",
        "r4's and r5's polygon is 'defined by foot positions': of all four feet, or of those that bear.\n"
        "All four, as printed; a lifted foot already costs r6.",
    )
    driven_smoothness: bool = _reading(
        True,
        "A32",
        "r8 wants abrupt accelerations 'slightly' penalised. As printed it also charges a steady turn, v ω, and the\n"
        "board's wobble: -9 a second at an action noise of 0.2, against +16 for tracking. By default the drive's own.",
        literal=False,
    )
    tilt_limit: float = _reading(
        1.0,
        "A34",
        "The paper ends an episode that 'risks flipping or falling'. The board itself may tilt by 0.78 rad,\n"
        "so 1.0 rad; the ancestors' 0.78 is meant for flat ground.",
        ancestor=0.78,
        low=0.05,
        high=math.pi / 2,
    )

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            name, point, value = field.name, field.metadata["point"], getattr(self, field.name)
            switch = isinstance(field.default, bool)
            if switch != isinstance(value, bool) or not isinstance(value, int | float):
                raise ReadingError(f"reading {name}={value!r}: choose {'True or False' if switch else 'a number'}")
            if not point.low <= value <= point.high:
                raise ReadingError(
                    f"reading {name}={value!r} is out of range; choose a value in [{point.low:g}, {point.high:g}]"
                )

    @property
    def sb_unit(self) -> float:
        """Factor from Table II's self-balancing gains to N m/rad and N m s/rad."""
        return 180.0 / math.pi if self.sb_gains_per_degree else 1.0


def points() -> dict[str, Point]:
    """What each field of :class:`Readings` decides, by name."""
    return {field.name: field.metadata["point"] for field in dataclasses.fields(Readings)}


def _profile(name: str) -> Readings:
    values = {field: getattr(point, name) for field, point in points().items()}
    return Readings(**{field: value for field, value in values.items() if value is not None})


PROFILES: Registry[Readings] = Registry("profile")
PROFILES.register("default", Readings())
PROFILES.register("literal", _profile("literal"))
PROFILES.register("ancestor", _profile("ancestor"))


def get_readings(profile: str | Readings = "default", **overrides: Any) -> Readings:
    """The readings of a named profile, with some fields replaced.

    Args:
        profile: a name of :data:`PROFILES`, or readings of your own.
        **overrides: fields of :class:`Readings` to replace.

    Raises:
        UnknownNameError: for an unknown profile or field.
        ReadingError: for a value out of range.

    Example:
        >>> get_readings("literal").sb_unit
        1.0
    """
    readings = profile if isinstance(profile, Readings) else PROFILES.get(profile)
    for name in overrides:
        if name not in points():
            raise unknown("reading", name, points())
    return dataclasses.replace(readings, **overrides)

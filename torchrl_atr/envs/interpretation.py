"""Open questions of the paper as settings: one field for each, and named profiles that answer all of them.

Numbers A1 ... A40 are those of docs/open_questions.md; ``torchrl-atr list questions`` prints every question with its
answers.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from torchrl_atr._registry import Registry, unknown
from torchrl_atr._settings import Setting, Settings, setting, settings


@dataclass(frozen=True)
class Interpretation(Settings):
    """Choices made where the paper is silent or contradicts itself; :func:`open_questions` gives the reasons.

    Raises:
        ConfigError: for a value out of range.

    Example:
        >>> Interpretation(tilt_limit=0.5).sb_unit
        57.29577951308232
    """

    group = "task.interpretation"

    relative_mass: bool = setting(True, question="A9", literal=False)
    """Divide drive and resistance by the mass relative to its nominal, not by the mass. Printed, Eqs. 1 and 3 peak at
    12 / 11.5 = 1.04 m/s² although the text says 12 m/s² at 45 degrees. Relative to the nominal mass both hold, and the
    board catches a leaning robot as a Segway does."""
    odd_resistance: bool = setting(True, question="A10", literal=False)
    """Let R(x) act against the motion. R(x) = 0.2 + 0.05 x + 0.005 x² is not odd: at x < 0 its constant would push. A
    resistance acts against the motion."""
    coulomb_smoothing: float = setting(
        0.5,
        within=(0.0, 10.0),
        question="A10",
        unit="m/s or rad/s",
        off=0.0,
        addition="a resistance that grows smoothly from rest",
    )
    """Speed x_s over which R grows from zero, tanh(x / x_s); 0 keeps the jump of sgn(x), which may stop the motion
    within a step but never reverse it. With a jump of the constant 0.2 at rest, no lean below 3 degrees of roll turns
    anything: learning sees no slope. Growing over 0.5 m/s (rad/s) the resistance hides nothing."""
    steering_smoothing: float = setting(0.0, within=(0.0, math.pi / 2), question="A11", unit="rad")
    """Pitch ε over which sgn(θ_y) in Eq. 3 changes sign, tanh(θ_y / ε); 0 as printed. Eq. 3's sgn(θ_y) flips the yaw
    where the pitch crosses zero. Kept as printed; a tanh over some pitch is smooth."""
    sb_gains_per_degree: bool = setting(True, question="A12", literal=False)
    """Read Table II's self-balancing gains as in N m/deg, not N m/rad. Table II prints the self-balancing gains without
    a unit. In N m/rad, an A1 standing 1 cm off centre would tilt the board by 66 degrees; in N m/deg it tilts by
    one."""
    scaled_springs: bool = setting(True, question="A12", literal=False)
    """Make the springs of the large (G2) transporters stiffer than Table II's: five times on the single board, two and
    a half times on each of two. Table II's springs fit the small (G1) robots; ANYmal-C and Spot need 4.6 to 6.3 times
    as much for the same k_SB over m g h. Two boards with five times each took twice the lean of the single board."""
    gains_as_ratios: bool = setting(True, question="A13", literal=False)
    """Read Table II's PD gains as ranges of ratios to a nominal of each robot, not 36-44 for all. Table II gives every
    robot PD gains of 36-44 and 0.8-1.2; Spot collapses on them. Read as ±10 % and ±20 % of a nominal of each robot: 40
    and 1 for A1 and Go1, 150 and 4.5 for the others."""
    relative_pose: bool = setting(True, question="A1", literal=False)
    """Let x_ext hold the relative pose. Table I gives x_ext 13 components, the text lists 16 and Table V shows 16.
    Thirteen is the list without the relative pose."""
    rewards_times_dt: bool = setting(True, question="A16", literal=False)
    """Multiply every reward by the control period. Not stated whether rewards are multiplied by the control period.
    legged_gym and its heirs do."""
    positive_rewards: bool = setting(False, question="A17", legged_gym=True)
    """Clip the summed reward (termination excepted) at zero. legged_gym clips the summed reward at zero; the paper does
    not mention it. Clipping erases most penalties, of a fall above all."""
    gravity_in_acceleration: bool = setting(False, question="A18", legged_gym=True)
    """Take v̇_B as the specific force of an IMU, not the kinematic acceleration. v̇_B is written as a kinematic
    acceleration; an IMU measures it plus gravity's reaction. Roll and pitch are observed beside it, so either can be
    had from the other."""
    current_in_history: bool = setting(False, question="A19")
    """End the estimators' history with o_t instead of o_{t-1}. The history is printed as o_{t-1} ... o_{t-H}, so
    estimates lag by one step, 20 ms. Extreme Parkour leaves o_t out as well; with it, estimates are of the present."""
    aligned_com: bool = setting(True, question="A40", off=False, addition="r2 of the centre of mass")
    """Let r2 be the distance of the robot's centre of mass from the platform's pivot, not that of its trunk's origin.
    Balance puts the centre of mass over the pivot. Hidden parameters part it from the trunk's origin by up to 7 (A1) to
    9 cm (Spot): r2 as printed pays for standing off balance, which drives the transporter."""
    contacting_polygon: bool = setting(False, question="A31")
    """Let r4's and r5's polygon be of the feet in contact; with fewer than three all is outside. r4's and r5's polygon
    is 'defined by foot positions': of all four feet, or of those in contact. All four, as printed; a lifted foot
    already costs r6."""
    driven_smoothness: bool = setting(True, question="A32", off=False, addition="r8 of the drive's accelerations alone")
    """Let r8 take the accelerations that the drive gives, without centripetal, roll's and pitch's. r8 penalises
    abrupt accelerations 'slightly'. As printed it also charges a steady turn, v ω, and the board's wobble: -9 a
    second at an action noise of 0.2, against +16 for tracking. By default the drive's own."""
    tilt_limit: float = setting(1.0, within=(0.05, math.pi / 2), question="A34", unit="rad", legged_gym=0.78)
    """Body roll or pitch beyond which the episode ends. The paper ends an episode that 'risks flipping or falling'. The
    board itself may tilt by 0.78 rad, so 1.0 rad; legged_gym's 0.78 is meant for flat ground."""

    @property
    def sb_unit(self) -> float:
        """Factor from Table II's self-balancing gains to N m/rad and N m s/rad."""
        return 180.0 / math.pi if self.sb_gains_per_degree else 1.0


def open_questions() -> dict[str, Setting]:
    """Return the question and answers behind each field of :class:`Interpretation`, by name."""
    return settings(Interpretation)


PROFILES: Registry[Interpretation] = Registry("profile")
"""Answers to the paper's open questions, by the name of the preset that takes them."""
for _name in ("default", "paper", "literal", "legged_gym"):
    PROFILES.register(
        _name, Interpretation(**{field: each.value_in(_name) for field, each in open_questions().items()})
    )


def get_interpretation(profile: str | Interpretation = "default", **overrides: Any) -> Interpretation:
    """Return the interpretation of a named profile, with some fields replaced.

    Args:
        profile: a name of :data:`PROFILES`, or an interpretation of your own.
        **overrides: fields of :class:`Interpretation` to replace.

    Raises:
        UnknownNameError: for an unknown profile or field.
        ConfigError: for a value out of range.

    Example:
        >>> get_interpretation("literal").sb_unit
        1.0
    """
    interpretation = profile if isinstance(profile, Interpretation) else PROFILES.get(profile)
    for name in overrides:
        if name not in open_questions():
            raise unknown("open question", name, open_questions())
    return dataclasses.replace(interpretation, **overrides)

"""The paper's ambiguous points as config values: one field per reading, three named profiles.

Numbers A9 ... A18 are those of the project's reading of the paper; each field says what the text leaves open.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from torchrl_atr._registry import Registry, UnknownNameError


@dataclass(frozen=True)
class Readings:
    """How the env reads the paper where it is silent or contradicts itself.

    Attributes:
        relative_mass: A9. Eqs. 1 and 3 divide by m_P and I_zz; printed, a G1 deck peaks at 1.04 m/s² although
            the text says 12. True divides by the mass relative to its nominal, so that the nominal deck
            reaches the text's peak.
        odd_resistance: A10. R(x) = 0.2 + 0.05 x + 0.005 x² pushes at x < 0 as printed. True acts against the
            motion.
        coulomb_smoothing: A10. Speed x_s (m/s or rad/s) over which the resistance grows from zero, s(x) =
            tanh(x / x_s); 0 keeps the jump of sgn(x), which may stop the motion within a step but never
            reverse it.
        steering_smoothing: A11. Pitch ε (rad) over which sgn(θ_y) in Eq. 3 changes sign, tanh(θ_y / ε); 0 as
            printed.
        sb_gains_per_degree: A12. Table II prints the self-balancing gains without a unit. True: N m/deg;
            False: N m/rad.
        rewards_times_dt: A16. Multiply every reward by the control period, as the paper's ancestors do.
        positive_rewards: A17. Clip the summed reward (termination excepted) at zero.
        gravity_in_acceleration: A18. False: v̇_B is the kinematic acceleration; True: the specific force of
            an IMU.
        planar_smoothness: r8's ‖α_P‖. True: the driven yaw acceleration; False: roll and pitch accelerations
            as well.
        tilt_limit: A34. Body roll or pitch (rad) beyond which the episode ends.
    """

    relative_mass: bool = True
    odd_resistance: bool = True
    coulomb_smoothing: float = 0.5
    steering_smoothing: float = 0.0
    sb_gains_per_degree: bool = True
    rewards_times_dt: bool = True
    positive_rewards: bool = False
    gravity_in_acceleration: bool = False
    planar_smoothness: bool = True
    tilt_limit: float = 1.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("coulomb_smoothing", 0.0, 10.0),
            ("steering_smoothing", 0.0, math.pi / 2),
            ("tilt_limit", 0.05, math.pi / 2),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"reading {name}={value!r} is out of range; choose a value in [{low:g}, {high:g}]")

    @property
    def sb_unit(self) -> float:
        """Factor from Table II's self-balancing gains to N m/rad and N m s/rad."""
        return 180.0 / math.pi if self.sb_gains_per_degree else 1.0


PROFILES: Registry[Readings] = Registry("profile")
PROFILES.register("default", Readings())
PROFILES.register(
    "literal",
    Readings(
        relative_mass=False,
        odd_resistance=False,
        sb_gains_per_degree=False,
        coulomb_smoothing=0.0,
        rewards_times_dt=False,
        planar_smoothness=False,
    ),
)
PROFILES.register(
    "ancestor", Readings(coulomb_smoothing=0.0, positive_rewards=True, gravity_in_acceleration=True, tilt_limit=0.78)
)


def get_readings(profile: str | Readings = "default", **overrides: Any) -> Readings:
    """The readings of a named profile, with some fields replaced.

    Args:
        profile: a name of :data:`PROFILES`, or readings of your own.
        **overrides: fields of :class:`Readings` to replace.

    Raises:
        UnknownNameError: for an unknown profile or field.
        ValueError: for a value out of range.

    Example:
        >>> get_readings("literal").sb_unit
        1.0
    """
    readings = profile if isinstance(profile, Readings) else PROFILES.get(profile)
    fields = [field.name for field in dataclasses.fields(Readings)]
    for name in overrides:
        if name not in fields:
            raise UnknownNameError(f"unknown reading {name!r}; known: {', '.join(fields)}")
    return dataclasses.replace(readings, **overrides)

"""Numbers, pairs and claims of the paper's experiments (Sec. V), as it prints them."""

from __future__ import annotations

from torchrl_atr._registry import nearest

GROUPS = {"G1": ("a1", "go1"), "G2": ("anymal_c", "spot")}
"""Robots of each group (Table IV); a group shares its transporters."""
TRANSPORTERS = ("single_board", "two_board")
PAIRS = tuple(f"{robot}-{board}" for robots in GROUPS.values() for robot in robots for board in TRANSPORTERS)
"""Names of the eight pairs."""
SPEEDS = {"G1": 1.5, "G2": 3.0}
"""Speed of long-range navigation, m/s."""
LATENT_ERROR = (0.0195, 0.0099)
"""Mean and standard deviation of the latent's error (Table V)."""
STATE_ERRORS = {
    "contacts[0]": (0.0170, 0.0085),
    "contacts[1]": (0.0610, 0.0293),
    "contacts[2]": (0.0246, 0.0109),
    "contacts[3]": (0.1035, 0.1608),
    "body_velocity[0]": (0.1128, 0.0976),
    "body_velocity[1]": (0.0557, 0.0155),
    "body_velocity[2]": (0.1073, 0.1653),
    "platform_velocity[0]": (0.1074, 0.1016),
    "platform_velocity[1]": (0.0564, 0.0124),
    "platform_velocity[2]": (0.0124, 0.0003),
    "platform_angular_velocity[0]": (0.0112, 0.0003),
    "platform_angular_velocity[1]": (0.0141, 0.0003),
    "platform_angular_velocity[2]": (0.0461, 0.0017),
    "relative_position[0]": (0.0361, 0.0017),
    "relative_position[1]": (0.0283, 0.0049),
    "relative_yaw[0]": (0.0013, 0.0008),
}
"""The same of each extrinsic state."""


def group_of(pair: str) -> str | None:
    """Return the group of a pair; None for one that is not the paper's.

    Example:
        >>> group_of("spot-two_board"), group_of("mine-sled")
        ('G2', None)
    """
    robot = pair.partition("-")[0]
    return next((group for group, robots in GROUPS.items() if pair in PAIRS and robot in robots), None)


def other_robot(pair: str) -> str | None:
    """Return the other robot of a pair's group; None for a pair that is not the paper's.

    Example:
        >>> other_robot("a1-two_board")
        'go1'
    """
    group = group_of(pair)
    return None if group is None else next(each for each in GROUPS[group] if each != pair.partition("-")[0])


def did_you_mean(pair: str) -> str:
    """Return the paper's pairs, the one that is nearest to a wrong name first."""
    return nearest(pair, PAIRS)

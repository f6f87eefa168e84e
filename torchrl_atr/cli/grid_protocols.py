"""Protocols of ``evaluate`` that measure a grid of commands: what each takes for options that are not given."""

from __future__ import annotations

import argparse
from typing import Any

GRID_PROTOCOLS: dict[str, dict[str, Any]] = {
    "tracking": {"randomization": "train", "max_yaw_rate": 1.0, "yaw_rate_step": 0.25, "robots_per_command": 8},
    "paper": {
        "randomization": "test",
        "max_speed": 15.0,
        "max_yaw_rate": 2.0,
        "speed_step": 0.1,
        "yaw_rate_step": 0.1,
        "robots_per_command": 1,
    },
}
"""``paper`` is the paper's evaluation: one robot of the test range at each of 12,341 commands, 10 s from rest."""


def fill_options(arguments: argparse.Namespace) -> None:
    """Give options that are not given, which are None, the values of the chosen protocol.

    Example:
        >>> given = argparse.Namespace(protocol="paper", randomization=None, max_speed=5.0, max_yaw_rate=None,
        ...                            speed_step=None, yaw_rate_step=None, robots_per_command=None)
        >>> fill_options(given)
        >>> given.randomization, given.max_speed
        ('test', 5.0)
    """
    for name, value in GRID_PROTOCOLS.get(arguments.protocol, {}).items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)

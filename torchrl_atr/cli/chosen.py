"""Choices that several commands of ``torchrl-atr`` offer: checkpoint, robot and transporter."""

from __future__ import annotations

import argparse
from typing import Any


def checkpoint_file(arguments: argparse.Namespace) -> str | None:
    """Return the file of the chosen checkpoint; None for the last one."""
    from torchrl_atr.runs.checkpoint import CHOICES

    return CHOICES[arguments.checkpoint]


def other_model(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the env arguments that replace the run's robot or transporter, if any are given."""
    asked = {name: getattr(arguments, name) for name in ("robot", "transporter")}
    return {name: value for name, value in asked.items() if value is not None}

"""Sizes and ranges of a comparison of estimators."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchrl_atr._checks import check_choice, check_number, check_whole
from torchrl_atr._errors import UserError
from torchrl_atr.envs.physics import CONTROL_DT


class ComparisonError(UserError):
    """Error of a comparison that cannot be made, or not be continued; the message names the remedy."""


@dataclass(frozen=True)
class CompareOptions:
    """Sizes of the recording, of the training and of the rides, and the ranges that they are drawn from.

    Attributes:
        robots: of the recording; a quarter of them is for validation, and as many ride on each trained estimator.
        seconds: length of the recording and of a ride on an estimator.
        updates: optimiser steps of each estimator.
        batch: control steps that each of them learns from.
        sequence: control steps of a sequence, for estimators with a hidden state.
        seeds: trainings of each estimator, which begin at other weights.
        seed: of the recording and of the first training.
        randomization: range of the intrinsic parameters: ``train``, ``test`` or ``off``.
        max_speed: largest |c_v|, m/s; None for 2, or the task's if that is less.
        max_yaw_rate: largest |c_ω|, rad/s; None for 1, likewise.
        command_seconds: duration of a command.

    Raises:
        InputError: for an impossible value.

    Example:
        >>> CompareOptions(robots=8, seconds=1.0).training, CompareOptions(robots=8, seconds=1.0).steps
        (6, 50)
    """

    robots: int = 256
    seconds: float = 60.0
    updates: int = 1000
    batch: int = 1024
    sequence: int = 64
    seeds: int = 3
    seed: int = 0
    randomization: str = "train"
    max_speed: float | None = None
    max_yaw_rate: float | None = None
    command_seconds: float = 5.0

    def __post_init__(self) -> None:
        check_whole("robots", self.robots, 2)
        for name in ("updates", "batch", "sequence", "seeds"):
            check_whole(name, getattr(self, name), 1)
        check_whole("seed", self.seed)
        check_number("seconds", self.seconds, CONTROL_DT)
        check_number("command_seconds", self.command_seconds, CONTROL_DT)
        check_choice("randomization", self.randomization, ("train", "test", "off"))

    @property
    def training(self) -> int:
        """Number of recorded robots that estimators are trained on; the others are for validation."""
        return min(max(1, round(0.75 * self.robots)), self.robots - 1)

    @property
    def riding(self) -> int:
        """Number of robots that ride on each trained estimator, and of those recorded for validation."""
        return self.robots - self.training

    @property
    def steps(self) -> int:
        """Number of control steps of the recording."""
        return round(self.seconds / CONTROL_DT)


QUICK = {"robots": 8, "seconds": 1.2, "updates": 4, "batch": 64, "sequence": 16, "seeds": 1}
"""Tiny sizes: they show that a comparison works, and measure nothing."""
SETTINGS = "settings.json"
"""File of the settings that the parts in a comparison's folder depend on."""


def check_settings(folder: Path, asked: Mapping[str, Any]) -> None:
    """Compare settings with those in a folder, if there are any.

    Raises:
        ComparisonError: naming one that differs, and the remedy.
    """
    path = folder / SETTINGS
    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else asked
    for name, value in asked.items():
        if known.get(name) != value:
            raise ComparisonError(
                f"{folder} holds a comparison with {name}={known.get(name)!r}, not {value!r}; ask for the same, or "
                "give another --output"
            )

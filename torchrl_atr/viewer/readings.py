"""Readings of the followed robot: one reading per control step, and a record of the last seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """Followed robot at one control step.

    Attributes:
        time: simulated time, s.
        command: in force, (C,), m/s and rad/s.
        actual: achieved after the step, (C,).
        estimated: what the estimator says the robot does of the command, (C,); NaN where it says nothing.
        truth: extrinsic state before the step, (E,).
        estimate: what the estimator made of it, (E,); NaN without an estimator.
        tilt: forward and steering tilt of the boards, rad, (2,); zero without a transporter.
        joint_power: positive mechanical power, summed over joints, W.
        drive_power: of the transporter's drive, W.
        weight: of the robot with its payload, N.
        rewards: of the step, by term.
        fell: whether the step ended the episode.
    """

    time: float
    command: Array
    actual: Array
    estimated: Array
    truth: Array
    estimate: Array
    tilt: Array
    joint_power: float
    drive_power: float
    weight: float
    rewards: dict[str, float]
    fell: bool


_SHAPES = {
    "time": (),
    "command": (2,),
    "actual": (2,),
    "estimated": (2,),
    "tilt": (2,),
    "joint_power": (),
    "drive_power": (),
    "weight": (),
}


class Record:
    """Readings of the last seconds, as columns.

    Args:
        steps: number of readings kept.
        components: number of components of the extrinsic state.
        terms: names of the reward terms.

    Example:
        >>> rest = [np.zeros(2)] * 6
        >>> record = Record(steps=3, components=2, terms=["speed"])
        >>> for time in range(5):
        ...     record.add(Reading(time, *rest, 60.0, 20.0, 120.0, {"speed": 1.0}, False))
        >>> record["time"].tolist(), record.mean_rewards(2)
        ([2.0, 3.0, 4.0], {'speed': 1.0})
    """

    def __init__(self, steps: int, components: int, terms: Sequence[str]) -> None:
        self.steps, self.terms, self._count = steps, tuple(terms), 0
        shapes = {**_SHAPES, "truth": (components,), "estimate": (components,), "rewards": (len(self.terms),)}
        self._values = {name: np.zeros((steps, *shape)) for name, shape in shapes.items()}

    def __len__(self) -> int:
        return min(self._count, self.steps)

    def add(self, reading: Reading) -> None:
        """Append a reading; the oldest one makes room."""
        row = self._count % self.steps
        for name, values in self._values.items():
            values[row] = (
                [reading.rewards[term] for term in self.terms] if name == "rewards" else getattr(reading, name)
            )
        self._count += 1

    def __getitem__(self, name: str) -> Array:
        """Return a copy of a column, oldest first, (T, ...)."""
        return np.roll(self._values[name], -(self._count % self.steps), axis=0)[self.steps - len(self) :]

    def mean_rewards(self, steps: int) -> dict[str, float]:
        """Return the mean reward of each term over the last steps."""
        recent = self["rewards"][-steps:]
        return dict(zip(self.terms, recent.mean(0).tolist())) if len(recent) else dict.fromkeys(self.terms, 0.0)

    def cost_of_transport(self, steps: int, slowest: float = 0.1) -> tuple[float, float]:
        """Return the cost of transport of joints, and of joints and drive, over the last steps; NaN at a standstill.

        Args:
            steps: to average over.
            slowest: mean speed below which there is no transport, m/s.
        """
        speed = float(np.abs(self["actual"][-steps:, 0]).mean()) if len(self) else 0.0
        if speed < slowest:
            return float("nan"), float("nan")
        joints, drive, weight = (float(self[name][-steps:].mean()) for name in ("joint_power", "drive_power", "weight"))
        return joints / (weight * speed), (joints + drive) / (weight * speed)

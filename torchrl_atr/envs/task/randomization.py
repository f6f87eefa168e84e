"""Table II: the intrinsic parameters x_int, their ranges, and their translation into physical units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from torchrl_atr._checks import check_choice
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.physics.engine import PhysicalParameters
from torchrl_atr.envs.profiles import Readings

Randomization = Literal["train", "test", "off"]
RANDOMIZATIONS: tuple[Randomization, ...] = ("train", "test", "off")
TABLE_II_KP, TABLE_II_KD = 40.0, 1.0
"""Midpoints of Table II's ranges, N m/rad and N m s/rad, for every robot if A13 is read literally."""
_MIN_MASS_SHARE = 0.1
"""A platform never gets lighter than this share of its nominal mass (A14)."""


@dataclass(frozen=True)
class IntrinsicParameter:
    """One row of Table II.

    Attributes:
        size: number of components; ``"joints"`` for one per leg joint.
        train: training range.
        test: testing range.
        nominal: the value without randomisation.
        ratio: the range multiplies a nominal of the robot or the deck (A13), instead of being the value.
    """

    size: int | Literal["joints"]
    train: tuple[float, float]
    test: tuple[float, float]
    nominal: float
    ratio: bool = False

    def scaled(self, value: Tensor) -> Tensor:
        """Maps the training range to [-1, 1]."""
        low, high = self.train
        return (2.0 * value - low - high) / (high - low)


INTRINSICS: dict[str, IntrinsicParameter] = {
    "payload": IntrinsicParameter(1, (0.0, 1.0), (0.0, 3.0), 0.0),
    "com_shift": IntrinsicParameter(3, (-0.2, 0.2), (-0.25, 0.25), 0.0),
    "kp": IntrinsicParameter("joints", (0.9, 1.1), (0.8, 1.2), 1.0, ratio=True),
    "kd": IntrinsicParameter("joints", (0.8, 1.2), (0.6, 1.4), 1.0, ratio=True),
    "platform_mass": IntrinsicParameter(1, (-0.5, 0.5), (-1.0, 1.0), 0.0),
    "friction": IntrinsicParameter(1, (0.8, 1.2), (0.7, 1.5), 1.0),
    "sb_stiffness": IntrinsicParameter(2, (0.8 / 1.15, 1.5 / 1.15), (0.5 / 1.15, 2.0 / 1.15), 1.0, ratio=True),
    "sb_damping": IntrinsicParameter(2, (0.8, 1.2), (0.4, 2.0), 1.0, ratio=True),
}
"""x_int by name in Table II's order; the self-balancing gains are ratios of their ranges' midpoints."""


def intrinsic_slices(joints: int) -> dict[str, slice]:
    """Where each parameter stands in x_int for a robot with ``joints`` leg joints."""
    slices, start = {}, 0
    for name, parameter in INTRINSICS.items():
        size = joints if parameter.size == "joints" else int(parameter.size)
        slices[name] = slice(start, start + size)
        start += size
    return slices


def sample_intrinsics(n: int, joints: int, randomization: Randomization, generator: torch.Generator) -> Tensor:
    """Draws x_int for n robots.

    Args:
        n: how many.
        joints: leg joints of the robot.
        randomization: ``"train"`` or ``"test"`` range of Table II, or ``"off"`` for the nominal values.
        generator: source of randomness.

    Returns:
        (n, 34) float32, each component scaled so that its training range is [-1, 1].

    Raises:
        ValueError: for another ``randomization``.

    Example:
        >>> x = sample_intrinsics(2, 12, "train", torch.Generator().manual_seed(0))
        >>> x.shape, bool((x.abs() <= 1).all())
        (torch.Size([2, 34]), True)
    """
    check_choice("randomization", randomization, RANDOMIZATIONS)
    low, high = _scaled_ranges(joints, randomization)
    return low + (high - low) * torch.rand(n, len(low), generator=generator, dtype=torch.float32)


@cache
def _scaled_ranges(joints: int, randomization: Randomization) -> tuple[Tensor, Tensor]:
    """Ends of x_int's range, (34,) each."""
    slices = intrinsic_slices(joints)
    low, high = torch.empty(2, sum(s.stop - s.start for s in slices.values()), dtype=torch.float32)
    for name, parameter in INTRINSICS.items():
        bounds = (parameter.nominal,) * 2 if randomization == "off" else getattr(parameter, randomization)
        ends = parameter.scaled(torch.tensor(bounds, dtype=torch.float32))
        low[slices[name]], high[slices[name]] = ends[0], ends[1]
    return low, high


@cache
def _training_range(joints: int) -> np.ndarray:
    """Ends of Table II's training range by component of x_int, float64, (2, 34)."""
    sizes = [part.stop - part.start for part in intrinsic_slices(joints).values()]
    return np.repeat([parameter.train for parameter in INTRINSICS.values()], sizes, axis=0).T


def table_values(x_int: Tensor, joints: int) -> dict[str, np.ndarray]:
    """Table II's values by name, (n, size) float64 each: the inverse of :meth:`IntrinsicParameter.scaled`.

    Args:
        x_int: (n, 34).
        joints: leg joints of the robot.
    """
    low, high = _training_range(joints)
    values = low + (x_int.double().numpy() + 1.0) * (high - low) / 2.0
    return {name: values[:, part] for name, part in intrinsic_slices(joints).items()}


def physical_parameters(x_int: Tensor, scene: Scene, readings: Readings) -> PhysicalParameters:
    """What x_int means in physical units for this robot and deck.

    Args:
        x_int: (n, 34), scaled as :func:`sample_intrinsics` returns it.
        scene: nominal gains and masses.
        readings: the self-balancing gains' unit and scale (A12), the PD gains' (A13).
    """
    robot, deck = scene.robot, scene.transporter
    value = table_values(x_int, len(robot.joints))
    mass = np.maximum(deck.mass + value["platform_mass"][:, 0], _MIN_MASS_SHARE * deck.mass)
    stiffness, damping = deck.springs(readings)
    return PhysicalParameters(
        payload=value["payload"][:, 0],
        com_shift=value["com_shift"],
        kp=value["kp"] * (robot.kp if readings.gains_as_ratios else TABLE_II_KP),
        kd=value["kd"] * (robot.kd if readings.gains_as_ratios else TABLE_II_KD),
        platform_mass=mass,
        friction=value["friction"][:, 0],
        sb_stiffness=value["sb_stiffness"] * stiffness,
        sb_damping=value["sb_damping"] * damping,
    )

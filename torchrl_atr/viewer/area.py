"""Area of commands that a policy has mastered, as the picture behind the joystick."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from torchrl_atr.deploy.manifest import report_home
from torchrl_atr.evaluation.metrics import mastered_commands
from torchrl_atr.evaluation.report import load_tracking
from torchrl_atr.evaluation.tracking import TrackingResult
from torchrl_atr.modules import CommandRange

_TRACKING = ("tracking.npz", "tracking/tracking.npz")
"""Files of a run's folder that ``torchrl-atr evaluate`` writes its trials to."""
_STEPS = 41
_MASTERED, _OTHER, _AXIS, _EDGE = (120, 200, 140), (228, 231, 235), (150, 156, 164), (90, 96, 104)
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class CommandArea:
    """Commands that a policy has mastered, on a grid of speeds and yaw rates.

    Attributes:
        speeds: increasing, m/s, (V,).
        yaw_rates: increasing, rad/s, (W,).
        mastered: mask of the mastered ones, (V, W).
        source: where it is from, for a caption.

    Example:
        >>> area = CommandArea.of_range(CommandRange(2.0, 1.0, 1.0))
        >>> area.limits, bool(area.mastered[-1, -1]), bool(area.mastered[-1, 20])
        ((2.0, 1.0), False, True)
    """

    speeds: NDArray[np.float64]
    yaw_rates: NDArray[np.float64]
    mastered: NDArray[np.bool_]
    source: str

    @classmethod
    def of_tracking(cls, result: TrackingResult) -> CommandArea:
        """Return the area of an evaluation: commands at which most robots stay up and settle near the command."""
        return cls(result.speed_commands, result.yaw_commands, mastered_commands(result), "mastered in the evaluation")

    @classmethod
    def of_range(cls, limits: CommandRange) -> CommandArea:
        """Return the area within a range, to which the deployed policy clips its commands."""
        speeds = np.linspace(-limits.max_speed, limits.max_speed, _STEPS)
        yaw_rates = np.linspace(-limits.max_yaw_rate, limits.max_yaw_rate, _STEPS)
        pairs = torch.from_numpy(np.stack(np.meshgrid(speeds, yaw_rates, indexing="ij"), -1))
        return cls(speeds, yaw_rates, (limits(pairs) == pairs).all(-1).numpy(), "the policy's range of commands")

    @property
    def limits(self) -> tuple[float, float]:
        """Largest |c_v| (m/s) and |c_ω| (rad/s) of the grid."""
        return float(np.abs(self.speeds).max()), float(np.abs(self.yaw_rates).max())


def mastered_area(folder: Path, limits: CommandRange | None) -> CommandArea | None:
    """Return the mastered area of a policy: of its evaluation, or else of its range; None where there is neither.

    Args:
        folder: of the run or bundle.
        limits: range of its commands, if it has one.
    """
    places = dict.fromkeys((folder, report_home(folder)))  # a bundle's evaluations are beside it
    for file in (place / name for place in places for name in _TRACKING):
        if file.is_file():
            try:
                return CommandArea.of_tracking(load_tracking(file))
            except (
                KeyError,
                ValueError,
                OSError,
                zipfile.BadZipFile,
            ):  # of an older version, or half written: the range is a good second
                break
    return None if limits is None else CommandArea.of_range(limits)


def pad_picture(area: CommandArea | None, limits: tuple[float, float], size: int = 201) -> Picture:
    """Draw the pad of the joystick: speed upwards, yaw rate to the left, mastered commands in green.

    Args:
        area: to be drawn; None leaves the pad empty.
        limits: |c_v| and |c_ω| at the pad's edges.
        size: of the picture, pixels.

    Returns:
        (size, size, 3), RGB.

    Example:
        >>> pad_picture(None, (2.0, 1.0), size=11).shape
        (11, 11, 3)
    """
    picture = np.full((size, size, 3), _OTHER, dtype=np.uint8)
    if area is not None:
        along = np.linspace(1.0, -1.0, size)  # rows from the top, columns from the left: both from plus to minus
        rows, inside_rows = _cells(area.speeds, along * limits[0])
        columns, inside_columns = _cells(area.yaw_rates, along * limits[1])
        inside = inside_rows[:, None] & inside_columns[None]
        picture[area.mastered[np.ix_(rows, columns)] & inside] = _MASTERED
    middle = size // 2
    picture[middle], picture[:, middle] = _AXIS, _AXIS
    for edge in (0, -1):
        picture[edge], picture[:, edge] = _EDGE, _EDGE
    return picture


def _cells(axis: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return for each value the nearest entry of an axis, and whether it is within half a step of the axis."""
    nearest = np.abs(values[:, None] - axis[None]).argmin(1)
    half = np.diff(axis).max() / 2 if len(axis) > 1 else 0.0
    return nearest, (values >= axis[0] - half) & (values <= axis[-1] + half)

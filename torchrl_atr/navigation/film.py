"""Moving overview of a trip: map, path, robot, speed and power."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from numpy.typing import NDArray

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic
from torchrl_atr.evaluation.plotting import PALETTE
from torchrl_atr.navigation.map import Map
from torchrl_atr.navigation.overview import COLOURS, draw_map
from torchrl_atr.navigation.paths import Path
from torchrl_atr.navigation.trips import GOAL, TripsResult

FRAMES, FPS = 80, 10
"""Frames of a film at most, and frames per second when it is shown."""
_SIZE, _DPI = (6.4, 3.6), 80
_ARROW = 7.0
"""Length of the robot's arrow on the map, m."""


class _Frames(NamedTuple):
    """Contents of the frames, one row each: time (s), x, y (m), yaw (rad), speed (m/s), powers (W)."""

    seconds: NDArray[np.float64]
    poses: NDArray[np.float64]
    speed: NDArray[np.float64]
    power: NDArray[np.float64]


def best_trip(result: TripsResult) -> int:
    """Return the trip to show: the longest that reached the goal; without any, the one that came farthest."""
    there = result.outcome == GOAL
    return int(np.where(there, result.planned, result.travelled if not there.any() else -1.0).argmax())


def film_best(result: TripsResult, paths: Sequence[Path], where: Map, file: str | FilePath) -> FilePath:
    """Film :func:`best_trip`, one of the trips along ``paths``: :func:`film_trip`."""
    trip = best_trip(result)
    return film_trip(result, paths[trip], where, trip, file)


def film_trip(result: TripsResult, path: Path, where: Map, trip: int, file: str | FilePath) -> FilePath:
    """Write a trip as a moving picture: the robot on the map and its path; speed and power over time.

    Speeds are of the distance between two recorded poses, powers means over the same time.

    Args:
        result: of :func:`~torchrl_atr.navigation.run_trips`.
        path: that this trip follows.
        where: the map.
        trip: index of the trip.
        file: ``.gif``; at most :data:`FRAMES` pictures, some 300 kB.

    Raises:
        InputError: for a file that is no ``.gif``, or a trip that is not there.
    """
    file = FilePath(file)
    if file.suffix != ".gif":
        raise InputError(f"{file} is not a .gif; a moving overview is written as one")
    if not 0 <= trip < len(result.traces):
        raise InputError(f"trip={trip} is not there; the result has trips 0 to {len(result.traces) - 1}")
    frames = _frames(result.traces[trip])
    figure, update = _picture(frames, path, where, str(result.outcome[trip]))
    moving = FuncAnimation(figure, update, frames=len(frames.seconds))
    with atomic(file) as temporary:
        moving.save(temporary, writer=PillowWriter(FPS), dpi=_DPI)
    return file


def _frames(trace: NDArray[np.float64]) -> _Frames:
    """Return evenly spaced rows of a trace, the last one included; quantities are means since the row before."""
    rows = np.unique(np.linspace(0, len(trace) - 1, min(len(trace), FRAMES)).round().astype(int))
    seconds = trace[:, 3]
    steps = np.diff(seconds, prepend=seconds[:1])[:, None]
    covered = np.linalg.norm(np.diff(trace[:, :2], axis=0, prepend=trace[:1, :2]), axis=-1, keepdims=True)
    total = np.concatenate([covered, steps * trace[:, 4:]], -1).cumsum(0)[rows]
    between = np.diff(seconds[rows], prepend=seconds[rows][:1])
    mean = np.diff(total, axis=0, prepend=total[:1]) / np.maximum(between, 1e-9)[:, None]
    return _Frames(seconds[rows], trace[rows, :3], mean[:, 0], mean[:, 1:])


def _picture(frames: _Frames, path: Path, where: Map, outcome: str) -> tuple[Figure, Any]:
    """Return the figure, and the function that draws one of the frames into it."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.subplot_mosaic("AB;AC", width_ratios=(1.15, 1.0))
    draw_map(axes["A"], where)
    axes["A"].plot(*path.points.T, color="0.6", linewidth=1.0)
    (trail,) = axes["A"].plot([], [], color=COLOURS[outcome], linewidth=1.5)
    robot = axes["A"].quiver(
        *frames.poses[0, :2], 1.0, 0.0, angles="xy", scale_units="xy", scale=1.0, width=0.02, zorder=3
    )
    curves = [
        *axes["B"].plot([], [], color=PALETTE[0]),
        *axes["C"].plot([], [], color=PALETTE[1], label="joints"),
        *axes["C"].plot([], [], color=PALETTE[2], label="drive"),
    ]
    values = [frames.speed, *frames.power.T]
    for name, label, shown in (("B", "speed, m/s", values[:1]), ("C", "power, W", values[1:])):
        top = 1.1 * max(float(np.max(each, initial=0.0)) for each in shown)
        axes[name].set(xlim=(0.0, max(frames.seconds[-1], 0.02)), ylim=(0.0, top or 1.0), ylabel=label)
        axes[name].grid(alpha=0.25)
    axes["C"].set_xlabel("time, s")
    axes["C"].legend(fontsize=8)

    def update(index: int) -> None:
        x, y, yaw = frames.poses[index]
        trail.set_data(frames.poses[: index + 1, 0], frames.poses[: index + 1, 1])
        robot.set_offsets((x, y))
        robot.set_UVC(_ARROW * np.cos(yaw), _ARROW * np.sin(yaw))
        for curve, value in zip(curves, values):
            curve.set_data(frames.seconds[1 : index + 1], value[1 : index + 1])
        ended = f": {outcome}" if index == len(frames.seconds) - 1 else ""
        axes["A"].set_title(f"{frames.seconds[index]:.0f} s{ended}", fontsize=9)

    return figure, update

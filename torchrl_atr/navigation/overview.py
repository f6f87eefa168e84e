"""Overview of trips: the map, the planned paths and what was travelled."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from torchrl_atr.evaluation.plotting import save
from torchrl_atr.navigation.map import Map
from torchrl_atr.navigation.paths import Path
from torchrl_atr.navigation.trips import COLLIDED, FELL, GOAL, TIMEOUT, TripsResult

COLOURS = {GOAL: "tab:blue", FELL: "tab:red", COLLIDED: "tab:orange", TIMEOUT: "tab:purple"}
"""Colour of a trip by its outcome."""


def plot_trips(result: TripsResult, paths: Sequence[Path], where: Map, file: str | FilePath) -> FilePath:
    """Draw the map, the planned paths (grey) and what was travelled, coloured by outcome."""
    figure = Figure(figsize=(7, 7), layout="constrained")
    axis = figure.subplots()
    draw_map(axis, where)
    for path, trace, outcome in zip(paths, result.traces, result.outcome):
        axis.plot(*path.points.T, color="0.8", linewidth=0.6)
        axis.plot(*trace[:, :2].T, color=COLOURS[str(outcome)], linewidth=0.8)
        axis.plot(*trace[-1, :2], "o", color=COLOURS[str(outcome)], markersize=3)
    shown = [name for name in COLOURS if (result.outcome == name).any()]
    handles = [
        Line2D([], [], color=COLOURS[name], label=f"{name}: {int((result.outcome == name).sum())}") for name in shown
    ]
    axis.legend(handles=handles, loc="upper left", fontsize=8)
    axis.set_title(f"{where.name}: {len(paths)} trips")
    return save(figure, file)


def draw_map(axis: Axes, where: Map) -> None:
    """Draw a map's free space, white, and its obstacles, grey."""
    for part in getattr(where.free, "geoms", [where.free]):
        axis.fill(*part.exterior.xy, facecolor="white", edgecolor="black", linewidth=0.8)
        for hole in part.interiors:
            axis.fill(*hole.xy, facecolor="0.75", edgecolor="0.5", linewidth=0.5)
    axis.set_facecolor("0.75")
    axis.set(aspect="equal", xlabel="x, m", ylabel="y, m")

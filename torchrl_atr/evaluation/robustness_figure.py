"""Figure of a robustness evaluation, as a PNG file. Importing this module imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchrl_atr.evaluation.plotting import COLOURS, GREY, PALETTE, STYLE, save

_COLUMNS = 4
_UP = PALETTE[2]
_TRAINING, _TEST = "0.84", "0.93"


def plot_robustness(metrics: Mapping[str, Any], path: str | Path) -> Path:
    """Plot share up and errors against every parameter, with 95 % intervals; shaded: training and test range.

    Args:
        metrics: of :func:`~torchrl_atr.evaluation.robustness.robustness_metrics`.
        path: the PNG to write.
    """
    parameters, baseline = metrics["parameters"], metrics["baseline"]
    columns = min(_COLUMNS, len(parameters))
    count = -(-len(parameters) // columns)
    with rc_context({**STYLE, "figure.constrained_layout.use": False}):
        figure = Figure(figsize=(3.2 * columns + 0.4, 3.3 * count + 0.5), layout="constrained")
        grid = figure.add_gridspec(count, columns)
        for number, (name, sweep) in enumerate(parameters.items()):
            cell = grid[number // columns, number % columns].subgridspec(2, 1, height_ratios=(1.5, 1.0), hspace=0.05)
            upper = figure.add_subplot(cell[0])
            lower = figure.add_subplot(cell[1], sharex=upper)
            _panel(upper, lower, name, sweep, baseline)
        figure.supxlabel(_conditions(metrics), fontsize=8, color=GREY, x=0.01, ha="left")
        return save(figure, path)


def _panel(upper: Axes, lower: Axes, name: str, sweep: Mapping[str, Any], baseline: Mapping[str, Any]) -> None:
    """Draw a parameter: share up above, errors below."""
    rows = sweep["rows"]
    named = any(isinstance(row["value"], str) for row in rows)
    x = np.arange(len(rows)) if named else np.array([row["value"] for row in rows], dtype=np.float64)
    style = "none" if named else "-"
    _line(upper, x, rows, "survival", _UP, style, "up")
    _line(lower, x, rows, "settled_speed_error", COLOURS["speed"], style, "speed [m/s]")
    _line(lower, x, rows, "settled_yaw_error", COLOURS["yaw"], style, "yaw rate [rad/s]")
    upper.axhline(baseline["survival"], ls=":", color=GREY, lw=1.0)
    for axis in (upper, lower):
        for ends, shade in ((sweep["test"], _TEST), (sweep["training"], _TRAINING)):
            if ends is not None and not named:
                axis.axvspan(*ends, color=shade, lw=0, zorder=0)
        axis.grid(alpha=0.25)
    upper.set(title=name.replace("_", " "), ylim=(-0.02, 1.02), ylabel="share up")
    upper.tick_params(labelbottom=False)
    lower.set_ylim(bottom=0.0)
    lower.set(ylabel="error")
    lower.legend(loc="best", fontsize=6)
    if named:
        lower.set_xticks(x, [row["value"].replace(" ", "\n", 1) for row in rows], fontsize=6)
        lower.set_xlim(-0.5, len(rows) - 0.5)
    else:
        lower.set_xlabel(f"[{sweep['unit']}]" if sweep["unit"] else "ratio to nominal")


def _line(axis: Axes, x: Any, rows: Any, name: str, colour: str, style: str, label: str) -> None:
    """Draw a figure of all rows with its interval; rows without it, in which no robot was up, are left out."""
    some = [i for i, row in enumerate(rows) if row[name] is not None]
    if not some:
        return
    middle = np.array([rows[i][name] for i in some], dtype=np.float64)
    ends = np.array([rows[i][f"{name}_interval"] for i in some], dtype=np.float64)  # None, of one robot, becomes NaN
    spread = np.nan_to_num(np.abs(ends.T - middle))
    axis.errorbar(x[some], middle, spread, color=colour, ls=style, lw=1.2, marker="o", ms=3, capsize=2, label=label)


def _conditions(metrics: Mapping[str, Any]) -> str:
    pushes = metrics["push_seconds"]
    return (
        f"{metrics['n']} robots in every ride, {metrics['seconds']:g} s; a command every "
        f"{metrics['command_seconds']:g} s; {'no pushes' if pushes is None else f'pushes every {pushes:g} s'}\n"
        "dark: training range, light: test range\ndotted: as trained; intervals are of 95 %"
    )

"""Figures of runs, as PNG files: learning curves and curricula. Importing this module imports matplotlib."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from torchrl_atr._errors import InputError
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.plotting import COLOURS, DASHES, SHARES, STYLE, Array, colour_bar, heatmap, save, subplots

LEARNING_CURVES: dict[str, str] = {
    "episode_length": "episode length [control steps]",
    "episode_reward": "return of an episode [1]",
    "reward": "reward per step [1]",
    "falls_per_minute": "falls per robot and minute [1/min]",
    "speed_error": "speed error [m/s]",
    "yaw_error": "yaw rate error [rad/s]",
    "command_area": "command area [share of grid]",
    "frontier_speed": "largest drawn $|c_v|$ [m/s]",
    "frontier_yaw_rate": "largest drawn $|c_\\omega|$ [rad/s]",
    "yaw_gain": "yaw rate reached [share of $c_\\omega$]",
    "student_speed_error": "speed error on estimates [m/s]",
    "latent_error": "latent error [norm]",
    "extrinsic_error": "extrinsic error [std]",
    "std": "action noise [action scale]",
    "kl_divergence": "KL divergence per update [nat]",
    "learning_rate": "learning rate [1]",
    "frames_per_second": "robot steps per second [1/s]",
}
"""Columns of ``progress.csv`` that have a panel, and their labels; columns that a run lacks are left out."""


def plot_learning_curves(progress_csv: str | Path, path: str | Path, curves: Mapping[str, str] | None = None) -> Path:
    """Plot the columns of a run's ``progress.csv`` that ``curves`` names, one panel each, over frames (or rows).

    Args:
        progress_csv: one row per iteration, with a header.
        path: the PNG to write.
        curves: labels by column; :data:`LEARNING_CURVES` by default.

    Raises:
        InputError: if the file has none of these columns, or no rows.
    """
    columns = read_columns(Path(progress_csv))
    known = LEARNING_CURVES if curves is None else curves
    labels = {name: label for name, label in known.items() if name in columns}
    if not labels or not len(columns[next(iter(labels))]):
        some = ", ".join(list(known)[:3])
        raise InputError(f"{progress_csv} has no rows, or none of the columns {some}, ...; give the log of a run")
    x: Array = (
        columns["frames"] / 1e6
        if "frames" in columns
        else np.arange(len(next(iter(columns.values()))), dtype=np.float64)
    )
    columns_shown = min(3, len(labels))
    rows = -(-len(labels) // columns_shown)
    x_label = "robot steps [million]" if "frames" in columns else "iteration"
    with rc_context(STYLE):
        figure, axes = subplots(rows, columns_shown, figsize=(3.7 * columns_shown, 2.4 * rows), squeeze=False)
        for axis, (name, label) in zip(axes.flat, labels.items()):
            if name == "falls_per_minute":  # few in any one iteration
                _noisy_line(axis, x, columns[name], COLOURS["speed"], "speed")
            else:
                axis.plot(x, columns[name], color=COLOURS["speed"], lw=1.2)
            axis.set(title=label, xlabel=x_label, ylim=_limits(columns[name]))
            axis.ticklabel_format(axis="y", useOffset=False, useMathText=True, scilimits=(-3, 5))
            axis.grid(alpha=0.25)
        for axis in list(axes.flat)[len(labels) :]:
            axis.remove()
        return save(figure, path)


def _limits(values: Array) -> tuple[float, float] | None:
    """Return the limits of an axis, which span at least a tenth of the values' magnitude."""
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    low, high = float(known.min()), float(known.max())
    least = 0.1 * max(abs(low), abs(high)) or 1.0
    middle, half = (low + high) / 2, max(high - low, least) / 2 * 1.08
    return middle - half, middle + half


def plot_runs(runs: Mapping[str, Mapping[str, str | Path]], path: str | Path) -> Path:
    """Plot episode length and return over the minutes of several runs, a column of two panels per group.

    Bold: mean over the last 15 iterations; faint: every iteration.

    Args:
        runs: by group, such as a robot, each line's label and the ``progress.csv`` it shows.
        path: the PNG to write.

    Raises:
        ValueError: if there is no run, or one without rows.
    """
    curves = {group: {label: read_columns(Path(f)) for label, f in lines.items()} for group, lines in runs.items()}
    empty = [f"{group}, {label}" for group, lines in curves.items() for label, columns in lines.items() if not columns]
    if empty or not curves:
        raise ValueError(f"no rows in the progress of {'; '.join(empty)}" if empty else "no runs to plot")
    colours = dict(zip(dict.fromkeys(label for lines in runs.values() for label in lines), cycle(COLOURS.values())))
    panels = (("episode_length", CONTROL_DT, "episode length [s]"), ("episode_reward", 1.0, "return of an episode [1]"))
    size = (1 + 2.6 * len(curves), 4.8)
    with rc_context(STYLE):
        figure, axes = subplots(2, len(curves), figsize=size, squeeze=False, sharex=True, sharey="row")
        for row, (name, unit, y_label) in zip(axes, panels):
            for axis, lines in zip(row, curves.values()):
                for style, (label, columns) in zip(cycle(DASHES), lines.items()):
                    _noisy_line(axis, columns["minutes"], unit * columns[name], colours[label], style)
                axis.set(ylabel=y_label, xlabel="training time [min]")
                axis.tick_params(labelbottom=True, labelleft=True)
                axis.grid(alpha=0.25)
        for axis, group in zip(axes[0], curves):
            axis.set_title(group)
        styles = dict(zip(colours, cycle(DASHES)))
        handles = [Line2D([], [], color=c, ls=DASHES[styles[label]], label=label) for label, c in colours.items()]
        figure.legend(handles=handles, loc="outside lower right", ncols=len(handles), handlelength=3)
        return save(figure, path)


def _noisy_line(axis: Axes, x: Array, y: Array, colour: str, style: str) -> None:
    axis.plot(x, y, color=colour, lw=0.6, alpha=0.25, zorder=1)
    axis.plot(x, rolling_mean(y), color=colour, ls=DASHES[style], lw=1.6)


def rolling_mean(values: Array) -> Array:
    """Return the mean over each value and the 14 before it, fewer at the start, (n,)."""
    return pd.Series(values).rolling(15, min_periods=1).mean().to_numpy()


def plot_curriculum(weights: Any, bounds: tuple[float, float], path: str | Path) -> Path:
    """Plot the command curriculum's weights over its grid.

    Args:
        weights: one weight in [0, 1] per cell, (cells along c_v, cells along c_ω).
        bounds: the largest |c_v| (m/s) and |c_ω| (rad/s): the outermost cells' centres.
        path: the PNG to write.
    """
    values = np.asarray(weights, dtype=np.float64)
    speeds, yaw_rates = (np.linspace(-bound, bound, cells) for bound, cells in zip(bounds, values.shape))
    with rc_context(STYLE):
        figure, axis = subplots(figsize=(8, 2.8))
        mesh = heatmap(axis, speeds, yaw_rates, values, SHARES, 1.0)
        axis.set_title("Command curriculum: commands are drawn in proportion to their weight")
        colour_bar(figure, axis, mesh, "weight [1]")
        return save(figure, path)


def read_columns(path: Path) -> dict[str, Array]:
    """Read the columns of a CSV file as numbers; empty and invalid cells are NaN."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = [name for name in (rows[0] if rows else ()) if name is not None]  # None: values beyond the header's
    return {name: np.array([_number(row[name]) for row in rows]) for name in names}


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")

"""Figures of evaluations and runs, as PNG files. Importing this module imports matplotlib."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from torchrl_atr._files import atomic
from torchrl_atr.envs.task.state import CONTROL_DT
from torchrl_atr.evaluation.metrics import EPSILONS, command_area, do_nothing
from torchrl_atr.evaluation.tracking import TrackingResult

Array = NDArray[np.float64]
SPEED, YAW = "$c_v$ [m/s]", "$c_\\omega$ [rad/s]"
# Okabe and Ito's colours, safe for colour-blind eyes
_COLOURS = {"speed": "#0072B2", "yaw": "#D55E00", "combined": "#009E73"}
_GREY = "0.55"
_ERRORS, _FALLS = "viridis", "cividis"
_MOST_LABELS = 60  # cells; with more, their values would not be readable
_LUMINANCE = (0.299, 0.587, 0.114)
_STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}
LEARNING_CURVES: dict[str, str] = {
    "episode_length": "episode length [steps]",
    "episode_reward": "episode reward",
    "reward": "reward per step",
    "speed_error": "speed error [m/s]",
    "yaw_error": "yaw rate error [rad/s]",
    "command_area": "command area [share of grid]",
    "frontier_speed": "largest drawn $|c_v|$ [m/s]",
    "frontier_yaw_rate": "largest drawn $|c_\\omega|$ [rad/s]",
    "yaw_gain": "share of the commanded yaw rate",
    "student_speed_error": "speed error on estimates [m/s]",
    "latent_error": "latent error",
    "extrinsic_error": "extrinsic error",
    "std": "action std",
    "kl_approx": "KL per update",
    "learning_rate": "learning rate",
    "frames_per_second": "frames per second",
}
"""Columns of ``progress.csv`` that have a panel, and their labels; those a run does not have are left out."""


def plot_heatmaps(result: TrackingResult, path: str | Path) -> Path:
    """Tracking errors over the command grid: RMS of speed, yaw rate and both, settled errors, fall rate.

    Each cell is the mean over its robots; settled errors are of survivors (white where there is none).
    """
    up = result.survived
    combined = np.hypot(result.rms_speed_error, result.rms_yaw_error)
    rms, settled = f"RMS over {result.seconds:g} s", f"settled, after {result.settle:g} s"
    panels = [
        (f"Speed error, {rms}", "m/s", _cells(result.rms_speed_error), _ERRORS),
        (f"Yaw rate error, {rms}", "rad/s", _cells(result.rms_yaw_error), _ERRORS),
        (f"Combined error, {rms}", "$\\sqrt{e_v^2 + e_\\omega^2}$", _cells(combined), _ERRORS),
        (f"Speed error, {settled}", "m/s", _cells(result.settled_speed_error, up), _ERRORS),
        (f"Yaw rate error, {settled}", "rad/s", _cells(result.settled_yaw_error, up), _ERRORS),
        ("Falls", "share of robots", 1.0 - up.mean(-1), _FALLS),
    ]
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(2, 3, figsize=(11.5, 6.2))
        for axis, (title, unit, values, colours) in zip(axes.flat, panels):
            top = 1.0 if colours == _FALLS else None
            _heatmap(axis, result.speed_commands, result.yaw_commands, values, colours, top)
            axis.set_title(title)
            figure.colorbar(axis.images[0], ax=axis, label=unit)
        return _save(figure, path)


def plot_response(result: TrackingResult, path: str | Path) -> Path:
    """What was asked against what came: settled speed over c_v, yaw rate over c_ω, one dot per survivor.

    The dashed diagonal is perfect tracking, the dotted line a board that stays still.
    """
    up = result.survived
    speeds, yaw_rates = result.speed_commands[:, None, None], result.yaw_commands[None, :, None]
    speeds, yaw_rates, _ = np.broadcast_arrays(speeds, yaw_rates, up)
    panels = [
        ("speed", speeds, result.settled_speed, yaw_rates, SPEED, "speed $v$ [m/s]", YAW),
        ("yaw", yaw_rates, result.settled_yaw_rate, speeds, YAW, "yaw rate $\\omega$ [rad/s]", SPEED),
    ]
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(10, 4.2))
        for axis, (name, asked, came, other, x_label, y_label, shade) in zip(axes, panels):
            limits = np.array([asked.min(), asked.max()])
            axis.plot(limits, limits, "--", color=_COLOURS[name], lw=1.2, label="perfect")
            axis.plot(limits, [0, 0], ":", color=_GREY, lw=1.2, label="do nothing")
            dots = axis.scatter(asked[up], came[up], c=other[up], cmap="cividis", s=14, alpha=0.8)
            figure.colorbar(dots, ax=axis, label=shade)
            axis.set(xlabel=x_label, ylabel=y_label, title=f"Settled {y_label.split(' $')[0]}")
            axis.locator_params(axis="x", nbins=5)
            axis.legend()
        return _save(figure, path)


def plot_command_area(result: TrackingResult, path: str | Path) -> Path:
    """Share of trials within ε, for speed, yaw rate and both; thin and dotted: a board that stays still."""
    still, ours = command_area(do_nothing(result)), command_area(result)
    titles = {
        "rms": f"RMS over {result.seconds:g} s from rest",
        "settled": f"settled, after {result.settle:g} s",
    }
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), sharey=True)
        for axis, (kind, title) in zip(axes, titles.items()):
            for name, colour in _COLOURS.items():
                axis.plot(EPSILONS, ours[kind][name], color=colour, lw=2, label=name)
                axis.plot(EPSILONS, still[kind][name], ":", color=colour, lw=1.2)
            axis.plot([], [], ":", color=_GREY, label="do nothing")
            axis.set(xlabel="$\\varepsilon$ [m/s, rad/s]", title=title, xlim=(0, EPSILONS[-1]), ylim=(0, 1.02))
            axis.grid(alpha=0.25)
        axes[0].set_ylabel("command area [share of trials]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
        return _save(figure, path)


def plot_learning_curves(progress_csv: str | Path, path: str | Path, curves: Mapping[str, str] | None = None) -> Path:
    """One panel for each column of a run's ``progress.csv`` that ``curves`` knows, over frames (or rows).

    Args:
        progress_csv: one row per iteration, with a header.
        path: the PNG to write.
        curves: labels by column; :data:`LEARNING_CURVES` by default.

    Raises:
        ValueError: if the file has none of these columns, or no rows.
    """
    columns = _read_columns(Path(progress_csv))
    known = LEARNING_CURVES if curves is None else curves
    labels = {name: label for name, label in known.items() if name in columns}
    if not labels or not len(columns[next(iter(labels))]):
        raise ValueError(f"{progress_csv} has no rows, or none of the columns {', '.join(known)}")
    x = columns["frames"] / 1e6 if "frames" in columns else np.arange(len(next(iter(columns.values()))))
    rows = -(-len(labels) // 3)
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(rows, 3, figsize=(11, 2.4 * rows), squeeze=False, sharex=True)
        for axis, (name, label) in zip(axes.flat, labels.items()):
            axis.plot(x, columns[name], color=_COLOURS["speed"], lw=1.4)
            axis.set_title(label)
            axis.grid(alpha=0.25)
        for axis in list(axes.flat)[len(labels) :]:
            axis.set_axis_off()
        figure.supxlabel("frames [million]" if "frames" in columns else "iteration", fontsize=9)
        return _save(figure, path)


def plot_runs(runs: Mapping[str, Mapping[str, str | Path]], path: str | Path) -> Path:
    """Episode length and return over the minutes of several runs, a column of two panels for each group of them.

    Bold: mean over the last 15 iterations; faint: every iteration.

    Args:
        runs: by group, such as a robot, each line's label and the ``progress.csv`` it shows.
        path: the PNG to write.

    Raises:
        ValueError: if there is no run, or one without rows.
    """
    curves = {group: {label: _read_columns(Path(f)) for label, f in lines.items()} for group, lines in runs.items()}
    empty = [f"{group}, {label}" for group, lines in curves.items() for label, columns in lines.items() if not columns]
    if empty or not curves:
        raise ValueError(f"no rows in the progress of {'; '.join(empty)}" if empty else "no runs to plot")
    colours = dict(zip(dict.fromkeys(label for lines in runs.values() for label in lines), cycle(_COLOURS.values())))
    panels = (("episode_length", CONTROL_DT, "episode length [s]"), ("episode_reward", 1.0, "return of an episode"))
    size = (1 + 2.6 * len(curves), 4.4)
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(2, len(curves), figsize=size, squeeze=False, sharex=True, sharey="row")
        for row, (name, unit, y_label) in zip(axes, panels):
            row[0].set_ylabel(y_label)
            for axis, lines in zip(row, curves.values()):
                for label, columns in lines.items():
                    _noisy_line(axis, columns["minutes"], unit * columns[name], colours[label])
                axis.grid(alpha=0.25)
        for axis, group in zip(axes[0], curves):
            axis.set_title(group)
        handles = [Line2D([], [], color=colour, label=label) for label, colour in colours.items()]
        figure.legend(handles=handles, loc="outside lower right", ncols=len(handles))
        figure.supxlabel("minutes", fontsize=9)
        return _save(figure, path)


def _noisy_line(axis: Axes, x: Array, y: Array, colour: str) -> None:
    axis.plot(x, y, color=colour, lw=0.6, alpha=0.25)
    axis.plot(x, pd.Series(y).rolling(15, min_periods=1).mean(), color=colour, lw=1.6)


def plot_curriculum(weights: Any, bounds: tuple[float, float], path: str | Path) -> Path:
    """The command curriculum's weights over its grid.

    Args:
        weights: one weight in [0, 1] per cell, (cells along c_v, cells along c_ω).
        bounds: the largest |c_v| (m/s) and |c_ω| (rad/s): the outermost cells' centres.
        path: the PNG to write.
    """
    values = np.asarray(weights, dtype=np.float64)
    axes_values = [np.linspace(-bound, bound, cells) for bound, cells in zip(bounds, values.shape)]
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(8, 2.8))
        _heatmap(axis, axes_values[0], axes_values[1], values, _FALLS, 1.0)
        axis.set_title("Command curriculum")
        figure.colorbar(axis.images[0], ax=axis, label="weight")
        return _save(figure, path)


def _cells(values: Array, chosen: NDArray[np.bool_] | None = None) -> Array:
    """Mean over the robots of each cell, NaN where none is chosen."""
    counted = np.isfinite(values) if chosen is None else chosen & np.isfinite(values)
    count = counted.sum(-1)
    total = np.where(counted, values, 0.0).sum(-1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _heatmap(axis: Axes, x: Array, y: Array, values: Array, colours: str, top: float | None) -> None:
    half = [(a[1] - a[0]) / 2 if len(a) > 1 else 0.5 for a in (x, y)]
    extent = (x[0] - half[0], x[-1] + half[0], y[0] - half[1], y[-1] + half[1])
    axis.imshow(values.T, origin="lower", extent=extent, aspect="auto", cmap=colours, vmin=0.0, vmax=top)
    axis.set(xlabel=SPEED, ylabel=YAW)
    if values.size <= _MOST_LABELS:
        _label_cells(axis, x, y, values)


def _label_cells(axis: Axes, x: Array, y: Array, values: Array) -> None:
    image = axis.images[0]
    for i, j in np.argwhere(np.isfinite(values)):
        light = np.dot(image.to_rgba(values[i, j])[:3], _LUMINANCE) > 0.5
        colour = "black" if light else "white"
        axis.text(x[i], y[j], f"{values[i, j]:.2f}", ha="center", va="center", fontsize=7, color=colour)


def _read_columns(path: Path) -> dict[str, Array]:
    """Columns of numbers; what is empty or no number is NaN."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([_number(row[name]) for row in rows]) for name in (rows[0] if rows else ())}


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")


def _save(figure: Figure, path: str | Path) -> Path:
    with atomic(path) as file:
        figure.savefig(file, dpi=130, facecolor="white")
    plt.close(figure)
    return Path(path)

"""Figures of evaluations and runs, as PNG files. Importing this module imports matplotlib."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from torchrl_atr._errors import InputError
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.metrics import EPSILONS, command_area, do_nothing
from torchrl_atr.evaluation.plotting import (
    GREY,
    SPEED,
    STYLE,
    YAW,
    Array,
    colour_bar,
    command_ticks,
    hatch_handle,
    heatmap,
    panel_size,
    save,
    spacing,
)
from torchrl_atr.evaluation.tracking import TrackingResult

# Okabe and Ito's colours, safe for colour-blind eyes
_COLOURS = {"speed": "#0072B2", "yaw": "#D55E00", "combined": "#009E73"}
_DASHES: dict[str, Any] = {"speed": "-", "yaw": (0, (5, 2)), "combined": (0, (1.2, 1.2))}
_WIDTHS = {"speed": 3.2, "yaw": 2.4, "combined": 1.8}
"""Narrow lines lie on wide ones, dashed on solid ones: none hides another where they coincide."""
_NAMES = {"speed": "speed", "yaw": "yaw rate", "combined": "combined, $\\sqrt{e_v^2 + e_\\omega^2}$"}
_ERRORS, _SHARES = "viridis", "cividis"
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
    "kl_approx": "KL divergence per update [nat]",
    "learning_rate": "learning rate [1]",
    "frames_per_second": "robot steps per second [1/s]",
}
"""Columns of ``progress.csv`` that have a panel, and their labels; those a run does not have are left out."""


def plot_heatmaps(result: TrackingResult, path: str | Path, largest: tuple[float, float] | None = None) -> Path:
    """Tracking errors over the command grid: RMS of speed, yaw rate and both, settled errors, fall rate.

    Each cell is the mean over its robots; settled errors are of survivors (hatched where there is none), RMS errors
    count up to a fall. Colours depend on the quantity and the grid alone, so that figures of one grid compare.

    Args:
        result: of :func:`~torchrl_atr.evaluation.evaluate_tracking`.
        path: the PNG to write.
        largest: errors of speed (m/s) and yaw rate (rad/s) at the ends of the colour scales, to compare grids; by
            default the largest commands, which is what a board scores that never moves.
    """
    up = result.survived
    combined = np.hypot(result.rms_speed_error, result.rms_yaw_error)
    rms, settled = f"RMS over {result.seconds:g} s", f"settled, after {result.settle:g} s"
    commands = result.speed_commands, result.yaw_commands
    tops = largest or [float(np.abs(axis).max()) or 1.0 for axis in commands]
    both = math.hypot(*tops)
    panels = [
        (f"Speed error, {rms}", "m/s", _cells(result.rms_speed_error), tops[0]),
        (f"Yaw rate error, {rms}", "rad/s", _cells(result.rms_yaw_error), tops[1]),
        (f"Combined error, {rms}", "$\\sqrt{e_v^2 + e_\\omega^2}$ [m/s, rad/s]", _cells(combined), both),
        (f"Speed error, {settled}", "m/s", _cells(result.settled_speed_error, up), tops[0]),
        (f"Yaw rate error, {settled}", "rad/s", _cells(result.settled_yaw_error, up), tops[1]),
        ("Falls", "share of robots", 1.0 - up.mean(-1), 1.0),
    ]
    width, height = panel_size(result.speed_commands, result.yaw_commands)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, 3, figsize=(3 * width, 2 * height + 0.35))
        for axis, (title, unit, values, top) in zip(axes.flat, panels):
            falls = title == "Falls"
            colours, power = (_SHARES, 1.0) if falls else (_ERRORS, 0.5)
            mesh = heatmap(axis, result.speed_commands, result.yaw_commands, values, colours, top, power)
            axis.set_title(title)
            colour_bar(figure, axis, mesh, unit)
        if not up.any(-1).all():
            figure.legend(handles=[hatch_handle("every robot fell: no settled error")], loc="outside lower right")
        note = (
            "Colours of errors: square-root scale from 0 to the largest command, what a board scores that never moves"
        )
        figure.supxlabel(note if largest is None else note.split(" to ")[0], fontsize=8, color=GREY, x=0.01, ha="left")
        return save(figure, path)


def plot_response(result: TrackingResult, path: str | Path) -> Path:
    """What was asked against what came: settled speed over c_v, yaw rate over c_ω, one dot per survivor.

    The dots of a command stand side by side in the order of the other command. A bar is perfect tracking, the dotted
    line a board that stays still.
    """
    up = result.survived
    speeds, yaw_rates = result.speed_commands, result.yaw_commands
    panels = [
        ("speed", speeds, yaw_rates, result.settled_speed, SPEED, "speed $v$ [m/s]", YAW),
        ("yaw", yaw_rates, speeds, result.settled_yaw_rate.swapaxes(0, 1), YAW, "yaw rate $\\omega$ [rad/s]", SPEED),
    ]
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(11, 4.2))
        for axis, (name, asked, others, came, x_label, y_label, shade) in zip(axes, panels):
            _response(axis, asked, others, np.where(up if name == "speed" else up.swapaxes(0, 1), came, np.nan), name)
            figure.colorbar(axis.collections[-1], ax=axis, label=shade)
            axis.set(xlabel=x_label, ylabel=y_label, title=f"Settled {y_label.split(' $')[0]}, one dot per robot")
        handles, labels = axes[0].get_legend_handles_labels()
        handles[0] = Line2D([], [], color=GREY, lw=2)
        figure.legend(handles, labels, loc="outside lower right", ncols=len(labels))
        figure.supxlabel(f"{up.sum()} of {up.size} robots stayed up", fontsize=8, color=GREY, x=0.01, ha="left")
        return save(figure, path)


def _response(axis: Axes, asked: Array, others: Array, came: Array, name: str) -> None:
    """One panel; ``came`` is (commands on its axis, other commands, robots), NaN where there is no dot."""
    reach = 0.38 * spacing(asked)
    axis.hlines(asked, asked - reach, asked + reach, color=_COLOURS[name], lw=2, label="perfect", zorder=1.5)
    axis.axhline(0.0, ls=":", color=GREY, lw=1.2, label="board that never moves", zorder=1)
    span = np.abs(others).max() or 1.0
    x = np.broadcast_to(asked[:, None, None] + 0.9 * reach * (others / span)[None, :, None], came.shape)
    shades = np.broadcast_to(others[None, :, None], came.shape)
    shown = np.isfinite(came)
    axis.scatter(x[shown], came[shown], c=shades[shown], cmap="cividis", vmin=-span, vmax=span, s=9, zorder=2)
    if not shown.any():
        axis.text(0.5, 0.6, "every robot fell", ha="center", transform=axis.transAxes)
    command_ticks(axis.xaxis, asked)


def plot_command_area(result: TrackingResult, path: str | Path) -> Path:
    """Share of trials within ε, for speed, yaw rate and both; in pale colours those of a board that never moves."""
    still, ours = command_area(do_nothing(result)), command_area(result)
    titles = {
        "rms": f"RMS over {result.seconds:g} s from rest",
        "settled": f"settled, after {result.settle:g} s",
    }
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(10.5, 3.9))
        for axis, (kind, title) in zip(axes, titles.items()):
            for order, (name, colour) in enumerate(_COLOURS.items()):
                line: Any = {"color": colour, "ls": _DASHES[name], "clip_on": False}
                axis.plot(EPSILONS, still[kind][name], **line, lw=1, alpha=0.8, zorder=2 + order)
                axis.plot(EPSILONS, ours[kind][name], **line, lw=_WIDTHS[name], label=_NAMES[name], zorder=5 + order)
            axis.plot([], [], color=GREY, lw=1, alpha=0.8, label="thin: board that\nnever moves")
            axis.set(xlabel="threshold $\\varepsilon$ [m/s, rad/s]", xlim=(0, EPSILONS[-1]), ylim=(0, 1))
            axis.set(ylabel="trials within $\\varepsilon$ [share]", title=title)
            axis.grid(alpha=0.25)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", handlelength=3)
        return save(figure, path)


def plot_learning_curves(progress_csv: str | Path, path: str | Path, curves: Mapping[str, str] | None = None) -> Path:
    """One panel for each column of a run's ``progress.csv`` that ``curves`` knows, over frames (or rows).

    Args:
        progress_csv: one row per iteration, with a header.
        path: the PNG to write.
        curves: labels by column; :data:`LEARNING_CURVES` by default.

    Raises:
        InputError: if the file has none of these columns, or no rows.
    """
    columns = _read_columns(Path(progress_csv))
    known = LEARNING_CURVES if curves is None else curves
    labels = {name: label for name, label in known.items() if name in columns}
    if not labels or not len(columns[next(iter(labels))]):
        some = ", ".join(list(known)[:3])
        raise InputError(f"{progress_csv} has no rows, or none of the columns {some}, ...; give the log of a run")
    count = len(next(iter(columns.values())))
    x = columns["frames"] / 1e6 if "frames" in columns else np.arange(count, dtype=np.float64)
    columns_shown = min(3, len(labels))
    rows = -(-len(labels) // columns_shown)
    x_label = "robot steps [million]" if "frames" in columns else "iteration"
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(rows, columns_shown, figsize=(3.7 * columns_shown, 2.4 * rows), squeeze=False)
        for axis, (name, label) in zip(axes.flat, labels.items()):
            if name == "falls_per_minute":  # few in any one iteration
                _noisy_line(axis, x, columns[name], _COLOURS["speed"], "speed")
            else:
                axis.plot(x, columns[name], color=_COLOURS["speed"], lw=1.2)
            axis.set(title=label, xlabel=x_label, ylim=_limits(columns[name]))
            axis.ticklabel_format(axis="y", useOffset=False, useMathText=True, scilimits=(-3, 5))
            axis.grid(alpha=0.25)
        for axis in list(axes.flat)[len(labels) :]:
            axis.remove()
        return save(figure, path)


def _limits(values: Array) -> tuple[float, float] | None:
    """Limits of an axis that does not blow up what hardly varies: at least a tenth of the values' size."""
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    low, high = float(known.min()), float(known.max())
    least = 0.1 * max(abs(low), abs(high)) or 1.0
    middle, half = (low + high) / 2, max(high - low, least) / 2 * 1.08
    return middle - half, middle + half


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
    panels = (("episode_length", CONTROL_DT, "episode length [s]"), ("episode_reward", 1.0, "return of an episode [1]"))
    size = (1 + 2.6 * len(curves), 4.8)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, len(curves), figsize=size, squeeze=False, sharex=True, sharey="row")
        for row, (name, unit, y_label) in zip(axes, panels):
            for axis, lines in zip(row, curves.values()):
                for style, (label, columns) in zip(cycle(_DASHES), lines.items()):
                    _noisy_line(axis, columns["minutes"], unit * columns[name], colours[label], style)
                axis.set(ylabel=y_label, xlabel="training time [min]")
                axis.tick_params(labelbottom=True, labelleft=True)
                axis.grid(alpha=0.25)
        for axis, group in zip(axes[0], curves):
            axis.set_title(group)
        styles = dict(zip(colours, cycle(_DASHES)))
        handles = [Line2D([], [], color=c, ls=_DASHES[styles[label]], label=label) for label, c in colours.items()]
        figure.legend(handles=handles, loc="outside lower right", ncols=len(handles), handlelength=3)
        return save(figure, path)


def _noisy_line(axis: Axes, x: Array, y: Array, colour: str, style: str) -> None:
    axis.plot(x, y, color=colour, lw=0.6, alpha=0.25, zorder=1)
    axis.plot(x, pd.Series(y).rolling(15, min_periods=1).mean(), color=colour, ls=_DASHES[style], lw=1.6)


def plot_curriculum(weights: Any, bounds: tuple[float, float], path: str | Path) -> Path:
    """The command curriculum's weights over its grid.

    Args:
        weights: one weight in [0, 1] per cell, (cells along c_v, cells along c_ω).
        bounds: the largest |c_v| (m/s) and |c_ω| (rad/s): the outermost cells' centres.
        path: the PNG to write.
    """
    values = np.asarray(weights, dtype=np.float64)
    speeds, yaw_rates = (np.linspace(-bound, bound, cells) for bound, cells in zip(bounds, values.shape))
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(8, 2.8))
        mesh = heatmap(axis, speeds, yaw_rates, values, _SHARES, 1.0)
        axis.set_title("Command curriculum: commands are drawn in proportion to their weight")
        colour_bar(figure, axis, mesh, "weight [1]")
        return save(figure, path)


def _cells(values: Array, chosen: NDArray[np.bool_] | None = None) -> Array:
    """Mean over the robots of each cell, NaN where none is chosen."""
    counted = np.isfinite(values) if chosen is None else chosen & np.isfinite(values)
    count = counted.sum(-1)
    total = np.where(counted, values, 0.0).sum(-1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _read_columns(path: Path) -> dict[str, Array]:
    """Columns of numbers; what is empty or no number is NaN."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = [name for name in (rows[0] if rows else ()) if name is not None]  # None: values beyond the header's
    return {name: np.array([_number(row[name]) for row in rows]) for name in names}


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")

"""Figures of evaluations and runs, as PNG files. Importing this module imports matplotlib."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from torchrl_atr.evaluation.metrics import EPSILONS, command_area, do_nothing_baseline, envelope_curve
from torchrl_atr.evaluation.plotting import (
    COLOURS,
    DASHES,
    GREY,
    SHARES,
    SPEED,
    STYLE,
    YAW,
    Array,
    colour_bar,
    command_ticks,
    draw_envelope,
    envelope_handles,
    hatch_handle,
    heatmap,
    panel_size,
    save,
    spacing,
    subplots,
)
from torchrl_atr.evaluation.tracking import TrackingResult

_WIDTHS = {"speed": 3.2, "yaw": 2.4, "combined": 1.8}
"""Line widths: narrow lines are drawn over wide ones and dashed over solid ones, so that none hides another."""
_NAMES = {"speed": "speed", "yaw": "yaw rate", "combined": "combined, $\\sqrt{e_v^2 + e_\\omega^2}$"}
_ERRORS = "viridis"


def plot_heatmaps(result: TrackingResult, path: str | Path, largest: tuple[float, float] | None = None) -> Path:
    """Plot tracking errors over the command grid: RMS of speed, yaw rate and both, settled errors, fall rate.

    Each cell is the mean over its robots; settled errors are of survivors (hatched where there is none), RMS errors
    count up to a fall. Colours depend on the quantity and the grid alone, so that figures of one grid are comparable.
    Lines bound the commands that can be followed at all (:class:`~torchrl_atr.evaluation.envelope.Envelope`).

    Args:
        result: of :func:`~torchrl_atr.evaluation.evaluate_tracking`.
        path: the PNG to write.
        largest: errors of speed (m/s) and yaw rate (rad/s) at the ends of the colour scales, to compare grids; by
            default the largest commands, the errors of a board that never moves.
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
    with rc_context(STYLE):
        figure, axes = subplots(2, 3, figsize=(3 * width, 2 * height + 0.35))
        for axis, (title, unit, values, top) in zip(axes.flat, panels):
            falls = title == "Falls"
            colours, power = (SHARES, 1.0) if falls else (_ERRORS, 0.5)
            mesh = heatmap(axis, result.speed_commands, result.yaw_commands, values, colours, top, power)
            axis.set_title(title)
            colour_bar(figure, axis, mesh, unit)
            if result.envelope is not None:
                draw_envelope(axis, result.envelope)
        handles: list[Any] = [] if result.envelope is None else envelope_handles()
        if not up.any(-1).all():
            handles.append(hatch_handle("every robot fell: no settled error"))
        if handles:
            figure.legend(handles=handles, loc="outside lower right", ncols=len(handles))
        note = (
            "Colours of errors: square-root scale from 0 to the largest command, what a board scores that never moves"
        )
        figure.supxlabel(note if largest is None else note.split(" to ")[0], fontsize=8, color=GREY, x=0.01, ha="left")
        return save(figure, path)


def plot_response(result: TrackingResult, path: str | Path) -> Path:
    """Plot the achieved over the commanded: settled speed over c_v, yaw rate over c_ω, one dot per survivor.

    The dots of a command are side by side in the order of the other command. A bar is perfect tracking, the dotted
    line a board that stays still.
    """
    up = result.survived
    speeds, yaw_rates = result.speed_commands, result.yaw_commands
    panels = [
        ("speed", speeds, yaw_rates, result.settled_speed, SPEED, "speed $v$ [m/s]", YAW),
        ("yaw", yaw_rates, speeds, result.settled_yaw_rate.swapaxes(0, 1), YAW, "yaw rate $\\omega$ [rad/s]", SPEED),
    ]
    with rc_context(STYLE):
        figure, axes = subplots(1, 2, figsize=(11, 4.2))
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
    """Draw one panel; ``came`` is (commands on its axis, other commands, robots), NaN where there is no dot."""
    reach = 0.38 * spacing(asked)
    axis.hlines(asked, asked - reach, asked + reach, color=COLOURS[name], lw=2, label="perfect", zorder=1.5)
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
    """Plot the share of trials within ε, for speed, yaw rate and both; pale: a board that never moves.

    Beside the settled yaw rate, in black: the share of the commands that can be followed within ε at all.
    """
    still, ours, bound = command_area(do_nothing_baseline(result)), command_area(result), envelope_curve(result)
    titles = {
        "rms": f"RMS over {result.seconds:g} s from rest",
        "settled": f"settled, after {result.settle:g} s",
    }
    with rc_context(STYLE):
        figure, axes = subplots(1, 2, figsize=(10.5, 3.9))
        for axis, (kind, title) in zip(axes, titles.items()):
            for order, (name, colour) in enumerate(COLOURS.items()):
                line: Any = {"color": colour, "ls": DASHES[name], "clip_on": False}
                axis.plot(EPSILONS, still[kind][name], **line, lw=1, alpha=0.8, zorder=2 + order)
                axis.plot(EPSILONS, ours[kind][name], **line, lw=_WIDTHS[name], label=_NAMES[name], zorder=5 + order)
            axis.plot([], [], color=GREY, lw=1, alpha=0.8, label="thin: board that\nnever moves")
            if bound is not None:
                shown = bound if kind == "settled" else []
                label = "yaw rate, settled, of the\nbest policy (bound)"
                axis.plot(EPSILONS[: len(shown)], shown, color="black", lw=1.2, label=label, zorder=4, clip_on=False)
            axis.set(xlabel="threshold $\\varepsilon$ [m/s, rad/s]", xlim=(0, EPSILONS[-1]), ylim=(0, 1))
            axis.set(ylabel="trials within $\\varepsilon$ [share]", title=title)
            axis.grid(alpha=0.25)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", handlelength=3)
        return save(figure, path)


def _cells(values: Array, chosen: NDArray[np.bool_] | None = None) -> Array:
    """Compute the mean over the robots of each cell, NaN where none is chosen."""
    counted = np.isfinite(values) if chosen is None else chosen & np.isfinite(values)
    count = counted.sum(-1)
    total = np.where(counted, values, 0.0).sum(-1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)

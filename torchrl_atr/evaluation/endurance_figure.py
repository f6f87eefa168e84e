"""Figure of an endurance evaluation, as a PNG file. Importing this module imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes

from torchrl_atr.evaluation.plotting import GREY, PALETTE, STYLE, save, subplots

_SPEED, _YAW, _UP, _ESTIMATE = PALETTE[:4]
_MOST_INTRINSICS = 6


def plot_endurance(metrics: Mapping[str, Any], path: str | Path) -> Path:
    """Plot survival, errors and estimates over time and the causes of falls; shaded: 95 % intervals.

    Args:
        metrics: of :func:`~torchrl_atr.evaluation.endurance_metrics`.
        path: the PNG to write.
    """
    curves, still = metrics["errors_over_time"], metrics["do_nothing"]
    with rc_context(STYLE):
        figure, axes = subplots(2, 3, figsize=(11.5, 6))
        survival = {**metrics["survival_over_time"], "mean": metrics["survival_over_time"]["share"]}
        _band(axes[0, 0], survival, _UP, f"Robots up: {metrics['survival']:.1%} at the end", "share of robots")
        axes[0, 0].set_ylim(0, 1.02)
        rows = (("speed", _SPEED, "Speed error", "m/s"), ("yaw", _YAW, "Yaw rate error", "rad/s"))
        for axis, (name, colour, title, unit) in zip(axes[0, 1:], rows):
            label = f"{title}, after {metrics['settle']:g} s of each command"
            _band(axis, {"seconds": curves["seconds"], **curves[name]}, colour, label, unit)
            axis.axhline(still[f"settled_{name}_error"], ls=":", color=GREY, lw=1.2, label="board that never moves")
            axis.set_ylim(bottom=0)
            axis.legend(loc="best")
        _causes(axes[1, 0], metrics)
        _intrinsics(axes[1, 1], metrics["fallen"]["intrinsics"])
        estimate = metrics["estimate_over_time"]
        if estimate is None:
            axes[1, 2].remove()
        else:
            unit = estimate["unit"] or "1"
            _band(axes[1, 2], estimate, _ESTIMATE, f"Estimate of {estimate['label']}: error", unit)
            axes[1, 2].set_ylim(bottom=0)
        figure.supxlabel(_conditions(metrics), fontsize=8, color=GREY, x=0.01, ha="left")
        return save(figure, path)


def _band(axis: Axes, curve: Mapping[str, Any], colour: str, title: str, unit: str) -> None:
    """Draw a line with its interval over time."""
    x, mean, low, high = (np.array(curve[name], dtype=np.float64) for name in ("seconds", "mean", "low", "high"))
    axis.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)
    axis.plot(x, mean, color=colour, lw=1.6, marker="." if len(x) == 1 else None)
    axis.set(title=title, xlabel="time [s]", ylabel=unit)
    axis.grid(alpha=0.25)


def _causes(axis: Axes, metrics: Mapping[str, Any]) -> None:
    """Draw the falls by cause; label the shares soon after a push or change of command, beside those by chance."""
    n, falls = metrics["n"], metrics["falls"]
    bars = [
        (name.replace("_", " "), cause["share"], cause["share_interval"])
        for name, cause in metrics["falls_by_cause"].items()
    ]
    axis.set(title=f"Falls by cause: {falls} of {n} robots", xlabel="share of robots")
    if not bars:
        axis.text(0.5, 0.5, "nobody fell", ha="center", transform=axis.transAxes)
        axis.set(xticks=[], yticks=[])
        return
    names, shares, intervals = zip(*reversed(bars))
    spread = np.abs(np.transpose(intervals) - np.array(shares))
    axis.barh(names, shares, xerr=spread, color=_SPEED, alpha=0.8, height=0.6, error_kw={"ecolor": GREY, "capsize": 2})
    lines = ["share of robots"]
    for name, after in metrics["falls_after"].items():
        if after["expected"] is not None:
            what = {"push": "a push", "command": "a change of command"}[name]
            share, chance = (f"{after[name]:.0%}" for name in ("share", "expected"))
            lines.append(f"{share} of the falls within {after['within']:g} s of {what}, {chance} of the time")
    axis.set_xlabel("\n".join(lines))


def _intrinsics(axis: Axes, compared: Mapping[str, Any]) -> None:
    """Draw the intrinsic parameters in which the fallen differ most from the survivors."""
    rows = [(name, row) for name, row in compared.items() if row["difference"] is not None][:_MOST_INTRINSICS]
    if not rows:
        axis.remove()
        return
    for place, (_, row) in enumerate(reversed(rows)):
        if None not in row["difference_interval"]:
            axis.hlines(place, *row["difference_interval"], color=GREY, lw=1.5)
        axis.plot(row["difference"], place, "o", color=_YAW)
    axis.axvline(0.0, color=GREY, lw=0.8)
    axis.set_yticks(range(len(rows)), [name.replace("_", " ") for name, _ in reversed(rows)])
    axis.set(title="Intrinsics of the fallen, less the survivors'", xlabel="difference [half the training range]")
    axis.grid(alpha=0.25, axis="x")


def _conditions(metrics: Mapping[str, Any]) -> str:
    low, high = metrics["commands"]["low"], metrics["commands"]["high"]
    pushes = "no pushes" if metrics["push_seconds"] is None else f"pushes every {metrics['push_seconds']:g} s"
    return (
        f"{metrics['n']} robots, {metrics['seconds']:g} s; a command every {metrics['command_seconds']:g} s in "
        f"[{low[0]:g}, {high[0]:g}] m/s x [{low[1]:g}, {high[1]:g}] rad/s; {pushes}. Shaded: 95 % intervals"
    )

"""Figures over several policies: heat maps of errors and command areas. Importing this module imports matplotlib."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context

from torchrl_atr.evaluation import TrackingResult, command_area
from torchrl_atr.evaluation.intervals import wilson
from torchrl_atr.evaluation.metrics import do_nothing_baseline
from torchrl_atr.evaluation.plotting import GREY, STYLE, Array, draw_envelope, envelope_handles, heatmap, save, subplots
from torchrl_atr.evaluation.set_figures import draw_band, finished, line_styles
from torchrl_atr.reproduction.tracking import EPSILONS

Results = Mapping[str, Sequence[TrackingResult]]
"""Results of the same commands by label; several of a label are seeds."""
_ACROSS = 4
_UNITS = {"speed": "m/s", "yaw rate": "rad/s", "combined": "$\\sqrt{e_v^2 + e_\\omega^2}$ [m/s, rad/s]"}


def plot_error_maps(results: Results, kinds: Sequence[str], path: str | Path) -> Path:
    """Plot the root mean square errors over the command space, for each label and kind one panel.

    Cells are means over robots and seeds, up to a fall; lines bound what can be followed at all.

    Args:
        results: by label.
        kinds: ``"speed"``, ``"yaw rate"``, ``"combined"``, or some of these.
        path: the PNG to write.
    """
    first = next(iter(results.values()))[0]
    tops = [float(np.abs(axis).max()) or 1.0 for axis in (first.speed_commands, first.yaw_commands)]
    scale = dict(zip(_UNITS, (*tops, math.hypot(*tops))))
    panels = [(label, kind) for label in results for kind in kinds]
    columns = min(_ACROSS, len(panels))
    rows = -(-len(panels) // columns)
    with rc_context(STYLE):
        figure, axes = subplots(
            rows, columns, figsize=(max(2.7 * columns + 1.0, 6.0), max(2.0 * rows, 2.6) + 0.6), squeeze=False
        )
        flat, meshes = list(axes.flat), {}
        for axis, (label, kind) in zip(flat, panels):
            values = np.mean([_errors(each, kind).mean(-1) for each in results[label]], axis=0)
            commands = first.speed_commands, first.yaw_commands
            meshes[kind] = heatmap(axis, *commands, values, "viridis", scale[kind], 0.5)
            axis.set_title(f"{label}: {kind}" if len(kinds) > 1 else label, fontsize=9)
            if (envelope := results[label][0].envelope) is not None:
                draw_envelope(axis, envelope)
        for axis in flat[len(panels) :]:
            axis.remove()
        for kind in kinds:
            figure.colorbar(meshes[kind], ax=flat[: len(panels)], label=f"{kind}: {_UNITS[kind]}", shrink=0.8)
        if any(each[0].envelope is not None for each in results.values()):
            figure.legend(handles=envelope_handles(), loc="outside lower right", ncols=2)
        return save(figure, path)


def _errors(result: TrackingResult, kind: str) -> Array:
    speed, yaw = result.rms_speed_error, result.rms_yaw_error
    return {"speed": speed, "yaw rate": yaw, "combined": np.hypot(speed, yaw)}[kind]


def plot_areas(results: Results, path: str | Path) -> Path:
    """Plot the share of trials within ε over ε, by root mean square from rest: speed, yaw rate and both.

    Bands reach from the lowest to the highest seed, or are the 95 % interval of a single one; dotted: a board that
    never moves.
    """
    with rc_context(STYLE):
        figure, axes = subplots(1, 3, figsize=(10.5, 3.2))
        still = command_area(do_nothing_baseline(next(iter(results.values()))[0]), EPSILONS)["rms"]
        for (label, each), style in zip(results.items(), line_styles()):
            areas = [command_area(result, EPSILONS)["rms"] for result in each]
            for axis, name in zip(axes, ("speed", "yaw", "combined")):
                lines = [np.array(area[name]) for area in areas]
                ends: Any = None
                if len(each) == 1:
                    n = each[0].fall_time.size
                    ends = np.array([wilson(round(share * n), n) for share in lines[0]]).T
                draw_band(axis, np.array(EPSILONS), lines, label, style, ends)
        for axis, name, title in zip(axes, still, ("speed", "yaw rate", "both")):
            axis.plot(EPSILONS, still[name], color=GREY, ls=":", lw=1.2, label="board that never moves")
            axis.set(title=f"{title}: trials within ε [share]", xlabel="ε [m/s, rad/s]", ylim=(0.0, 1.02))
        return save(finished(figure, axes), path)

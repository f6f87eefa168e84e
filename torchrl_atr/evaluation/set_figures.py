"""Figures over sets of runs, such as methods of several seeds, for papers. Importing this module imports matplotlib."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest
from torchrl_atr._text import split_label
from torchrl_atr.evaluation.figures import plot_heatmaps
from torchrl_atr.evaluation.plotting import DASHES, PALETTE, STYLE, Array, save, subplots
from torchrl_atr.evaluation.report import load_tracking
from torchrl_atr.evaluation.run_figures import LEARNING_CURVES, read_columns, rolling_mean

RunSets = Mapping[str, Sequence[Path]]
"""Runs, or folders of evaluations, by the label of their line: several of one label are seeds of the same thing."""
CURVES = ("reward", "episode_length", "falls_per_minute", "student_speed_error", "yaw_error", "command_area")
"""Columns of ``progress.csv`` that are drawn by default."""
_PAPER: Any = {**STYLE, "pdf.fonttype": 42, "svg.fonttype": "none"}  # text stays text
_POINTS = 200
"""Points of a learning curve."""
_DASHES: Any = (*DASHES.values(), (0, (5, 1.5, 1.2, 1.5)))
_AREAS = {"speed": "speed", "yaw": "yaw rate", "combined": "both"}


def group_runs(given: Iterable[str]) -> dict[str, list[Path]]:
    """Return folders by label, from texts ``FOLDER`` or ``LABEL=FOLDER``.

    Raises:
        InputError: for a folder that does not exist.

    Example:
        >>> group_runs(["runs/a", "ours=runs/b", "ours=runs/c"])  # doctest: +SKIP
        {'a': [PosixPath('runs/a')], 'ours': [PosixPath('runs/b'), PosixPath('runs/c')]}
    """
    sets: dict[str, list[Path]] = {}
    for text in given:
        label, folder = split_label(text)
        path = Path(folder)
        if not folder or not path.is_dir():
            raise InputError(f"{folder or text!r} is no folder; give RUN or LABEL=RUN, RUN being the folder of a run")
        sets.setdefault(label or path.resolve().name, []).append(path)
    return sets


def plot_sets(
    sets: RunSets, folder: str | Path, suffix: str = "pdf", curves: Sequence[str] | None = None
) -> list[Path]:
    """Plot whatever the folders hold: learning curves, survival, command areas, heat maps.

    Lines are means over the runs of a label, bands reach from the lowest run to the highest; both end with the shortest
    run. With a single run, the band of an evaluation is its 95 % interval.

    Args:
        sets: of :func:`group_runs`.
        folder: where the figures go.
        suffix: ``pdf`` or ``svg`` (vectors), or ``png``.
        curves: columns of ``progress.csv``; None for those of :data:`CURVES` that there are.

    Returns:
        The files.

    Raises:
        InputError: if a folder holds nothing that is plotted, or ``curves`` names what is no column of its.
    """
    folder = Path(folder)
    held = {label: [_held(path) for path in paths] for label, paths in sets.items()}
    logs, endurance, tracking = (_having(held, part) for part in ("progress", "endurance", "tracking"))
    plots: dict[str, Callable[[], Figure]] = {
        **({"learning_curves": lambda: _learning_curves(logs, curves)} if logs else {}),
        **({"endurance": lambda: _endurance(endurance)} if endurance else {}),
        **({"command_area": lambda: _command_areas(tracking)} if tracking else {}),
    }
    with rc_context(_PAPER):
        written = [save(plot(), folder / f"{name}.{suffix}") for name, plot in plots.items()]
        for label, trials in _having(held, "trials").items():
            name = re.sub(r"[^\w.-]+", "-", label)
            written.append(plot_heatmaps(load_tracking(trials[0]), folder / f"heatmaps-{name}.{suffix}"))
    return written


def _held(path: Path) -> dict[str, Any]:
    """Return what a folder holds: columns of its ``progress``, metrics by protocol, and the file of the ``trials``.

    Reports are in the folder itself or in subfolders with the names of the protocols.
    """
    held: dict[str, Any] = {}
    if (log := path / "progress.csv").is_file() and (columns := read_columns(log)):  # none without rows
        held["progress"] = columns
    for protocol in ("endurance", "tracking"):
        for file in (path / protocol / "metrics.json", path / "metrics.json"):  # the folder's own has precedence
            if file.is_file() and (metrics := json.loads(file.read_text(encoding="utf-8"))).get("protocol") == protocol:
                held[protocol] = metrics
                if protocol == "tracking" and (trials := file.with_name("tracking.npz")).is_file():
                    held["trials"] = trials
    if not held:
        raise InputError(
            f"{path} has neither progress.csv nor metrics.json of an evaluation; give the folder of a run, of its "
            "bundle, or of the report of `torchrl-atr evaluate`"
        )
    return held


def _having(held: Mapping[str, Sequence[Mapping[str, Any]]], part: str) -> dict[str, list[Any]]:
    """Return a part of what the folders of each set hold; sets without any are left out."""
    found = {label: [each[part] for each in folders if part in each] for label, folders in held.items()}
    return {label: parts for label, parts in found.items() if parts}


def _learning_curves(logs: Mapping[str, Sequence[Mapping[str, Array]]], chosen: Sequence[str] | None) -> Figure:
    known = {column for tables in logs.values() for table in tables for column in table}
    curves = [name for name in CURVES if name in known] if chosen is None else chosen
    for name in curves:
        if name not in known:
            raise InputError(f"progress.csv has no column {name!r}; {nearest(name, sorted(known))}")
    figure, axes = _panels(len(curves))
    for axis, name in zip(axes, curves):
        for (label, tables), style in zip(logs.items(), line_styles()):
            shown = [table for table in tables if name in table]
            if shown:
                x = np.linspace(0.0, min(table["frames"][-1] for table in shown), _POINTS)
                lines = [np.interp(x, table["frames"], rolling_mean(table[name])) for table in shown]
                draw_band(axis, x / 1e6, lines, label, style)
        axis.set(title=LEARNING_CURVES.get(name, name.replace("_", " ")), xlabel="robot steps [million]")
    return finished(figure, axes)


def _endurance(sets: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    figure, axes = _panels(3)
    for (label, reports), style in zip(sets.items(), line_styles()):
        _reported(axes[0], [report["survival_over_time"] for report in reports], "share", label, style)
        for axis, name in zip(axes[1:], ("speed", "yaw")):
            times = [
                {"seconds": each["seconds"], **each[name]}
                for each in (report["errors_over_time"] for report in reports)
            ]
            _reported(axis, times, "mean", label, style)
    for axis, title in zip(axes, ("robots up [share]", "speed error [m/s]", "yaw rate error [rad/s]")):
        axis.set(title=title, xlabel="time [s]")
        axis.set_ylim(0.0, 1.02 if axis is axes[0] else None)
    return finished(figure, axes)


def _reported(axis: Axes, curves: Sequence[Mapping[str, Any]], value: str, label: str, style: Any) -> None:
    """Draw a curve of reports over their common time: the interval of one, or the mean of several."""
    x = np.array(min((curve["seconds"] for curve in curves), key=len), dtype=np.float64)
    lines = [np.array(curve[value], dtype=np.float64)[: len(x)] for curve in curves]
    ends = None if len(curves) > 1 else [np.array(curves[0][end], dtype=np.float64) for end in ("low", "high")]
    draw_band(axis, x, lines, label, style, ends)


def _command_areas(sets: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    figure, axes = _panels(3)
    for (label, reports), style in zip(sets.items(), line_styles()):
        areas = [report["command_area"] for report in reports]
        for axis, name in zip(axes, _AREAS):
            lines = [np.array(area["settled"][name], dtype=np.float64) for area in areas]
            draw_band(axis, np.array(areas[0]["epsilon"], dtype=np.float64), lines, label, style)
    for axis, title in zip(axes, _AREAS.values()):
        axis.set(title=f"settled {title}: trials within ε [share]", xlabel="ε [m/s, rad/s]", ylim=(0.0, 1.02))
    return finished(figure, axes)


def line_styles() -> Any:
    """Yield colours and dashes of lines without end; no two of the first 28 look alike."""
    return zip(cycle(PALETTE), (dash for dash in cycle(_DASHES) for _ in PALETTE))


def draw_band(
    axis: Axes, x: Array, lines: Sequence[Array], label: str, style: Any, ends: Sequence[Array] | None = None
) -> None:
    """Draw the mean of some lines, and a band between ``ends``, or between the lowest and the highest line."""
    stacked, (colour, dashes) = np.stack(lines), style
    low, high = (stacked.min(0), stacked.max(0)) if ends is None else ends
    if ends is not None or len(lines) > 1:
        axis.fill_between(x, low, high, color=colour, alpha=0.18, lw=0)
    named = label if len(lines) == 1 else f"{label} ({len(lines)} runs)"
    axis.plot(x, stacked.mean(0), color=colour, ls=dashes, lw=1.5, label=named)


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    columns = min(3, count)
    rows = -(-count // columns)
    figure, axes = subplots(rows, columns, figsize=(3.3 * columns, 2.5 * rows + 0.3), squeeze=False)
    for axis in list(axes.flat)[count:]:
        axis.remove()
    return figure, list(axes.flat)[:count]


def finished(figure: Figure, axes: Sequence[Axes]) -> Figure:
    """Add grids, and the first panel's legend below all; return the figure."""
    for axis in axes:
        axis.grid(alpha=0.25)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(4, max(1, len(labels))), handlelength=3)
    return figure

"""Shared parts of the figures: style, heat maps, ticks, files. Importing this module imports matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import QuadMesh
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FixedLocator, MaxNLocator
from numpy.typing import NDArray

from torchrl_atr._files import atomic
from torchrl_atr.evaluation.envelope import SETTLED_YAW_ERROR, Envelope

Array = NDArray[np.float64]
SPEED, YAW = "$c_v$ [m/s]", "$c_\\omega$ [rad/s]"
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "hatch.linewidth": 0.6,
}
GREY = "0.4"
# Okabe and Ito's colours, safe for colour-blind eyes
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
COLOURS = dict(zip(("speed", "yaw", "combined"), PALETTE))
DASHES: dict[str, Any] = {"speed": "-", "yaw": (0, (5, 2)), "combined": (0, (1.2, 1.2))}
SHARES = "cividis"
"""Colour map of shares and weights."""
_HATCH: Any = {"facecolor": "0.95", "edgecolor": "0.6", "hatch": "///////", "linewidth": 0.0}
_OUTLINE = "#E6009A"
"""Colour of the envelope's outline, in neither colour map."""
_REWARD_LINE: Any = {"linestyles": "-", "linewidths": 1.4}
_FRICTION_LINE: Any = {"linestyles": ":", "linewidths": 1.4}
_MOST_LABELS = 15
"""Largest number of cells in a row whose values are printed."""
_MOST_TICKS = 7
_LUMINANCE = (0.299, 0.587, 0.114)


def subplots(rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **grid: Any) -> tuple[Figure, Any]:
    """Return a figure of no window and no backend, whatever the user's pyplot shows, and its axes."""
    figure = Figure(figsize=figsize)
    return figure, figure.subplots(rows, columns, **grid)


def heatmap(axis: Axes, x: Array, y: Array, values: Array, colours: str, top: float, power: float = 1.0) -> QuadMesh:
    """Draw ``values`` over a grid of commands; cells without a value are hatched.

    Args:
        axis: to draw on.
        x: speeds, m/s, (V,), in any order and at any distances.
        y: yaw rates, rad/s, (W,), likewise.
        values: non-negative, (V, W), NaN where there is none.
        colours: name of a colour map.
        top: value of its last colour, which larger values have, too.
        power: exponent of the colour scale; 0.5 resolves small values beside large ones.

    Returns:
        The mesh, for a colour bar.
    """
    rows, columns = np.argsort(x), np.argsort(y)
    x, y, values = x[rows], y[columns], values[np.ix_(rows, columns)]
    edges = _edges(x), _edges(y)
    corner, size = (edges[0][0], edges[1][0]), (np.ptp(edges[0]), np.ptp(edges[1]))
    axis.add_patch(Rectangle(corner, *size, zorder=0, **_HATCH))
    norm = PowerNorm(power, 0.0, top, clip=True)
    mesh = axis.pcolormesh(*edges, np.ma.masked_invalid(values.T), cmap=colours, norm=norm, zorder=1)
    axis.set(xlabel=SPEED, ylabel=YAW, xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]])
    command_ticks(axis.xaxis, x)
    command_ticks(axis.yaxis, y)
    if max(values.shape) <= _MOST_LABELS:
        _label_cells(axis, mesh, x, y, values)
    return mesh


def draw_envelope(axis: Axes, envelope: Envelope) -> None:
    """Outline the commands that can be followed at all, under the reward and by friction alone.

    An outline that would lie outside the panel is left out.
    """
    speeds, yaw_rates = (np.linspace(*limits, 400) for limits in (axis.get_xlim(), axis.get_ylim()))
    for reward, style in ((True, _REWARD_LINE), (False, _FRICTION_LINE)):
        held = envelope.follows(speeds, yaw_rates, reward).astype(float)
        if not held.all():
            axis.contour(speeds, yaw_rates, held.T, [0.5], colors=_OUTLINE, zorder=2, **style)


def envelope_handles() -> list[Line2D]:
    """Return the legend entries of :func:`draw_envelope`."""
    labels = {f"within {SETTLED_YAW_ERROR:g} rad/s under the reward": _REWARD_LINE, "by friction": _FRICTION_LINE}
    return [
        Line2D([], [], color=_OUTLINE, lw=style["linewidths"], ls=style["linestyles"], label=f"bound: {label}")
        for label, style in labels.items()
    ]


def colour_bar(figure: Figure, axis: Axes, mesh: QuadMesh, label: str) -> None:
    """Add the colour bar of a heat map, with an arrow where values exceed it."""
    values: Any = np.ma.asarray(mesh.get_array())
    beyond = bool(values.count()) and values.max() > mesh.get_clim()[1]
    bar = figure.colorbar(mesh, ax=axis, label=label, extend="max" if beyond else "neither")
    ticks = _scale_ticks(mesh.norm)
    bar.set_ticks(ticks, labels=[f"{tick:.3g}" for tick in ticks])


def _scale_ticks(norm: Any) -> list[float]:
    """Return the ends of a colour scale, and well-separated numbers of one digit between them."""
    top = float(norm.vmax or 1.0)
    decades = 10.0 ** np.arange(np.floor(np.log10(top)), np.floor(np.log10(top)) - 4, -1)
    ticks = [top]
    for value in (digit * decade for decade in decades for digit in (8, 6, 5, 4, 3, 2, 1)):
        place = float(norm(value))
        if place < float(norm(ticks[-1])) - 0.12 and place > 0.1:
            ticks.append(value)
    return [0.0, *reversed(ticks)]


def hatch_handle(label: str) -> Patch:
    """Return the legend entry of cells without a value."""
    return Patch(label=label, **_HATCH)


def panel_size(x: Sequence[float] | Array, y: Sequence[float] | Array) -> tuple[float, float]:
    """Return width and height of a heat map with its labels and colour bar, inches; they grow with the grid."""
    return float(np.clip(0.36 * len(x), 2.9, 4.4)) + 0.9, float(np.clip(0.26 * len(y), 2.3, 3.8)) + 0.75


def command_ticks(axis: Axis, values: Array) -> None:
    """Put ticks at the commands if they are few, else at multiples of 1, 2 or 5 times a power of ten."""
    few = len(values) <= _MOST_TICKS
    axis.set_major_locator(FixedLocator(list(values)) if few else MaxNLocator(_MOST_TICKS, steps=[1, 2, 5, 10]))
    if few:
        axis.set_ticks(list(values), [f"{value:g}".replace("-", "\N{MINUS SIGN}") for value in values])


def spacing(values: Array) -> float:
    """Return the smallest distance between two of the commands; 1 if there is only one."""
    return float(np.diff(np.unique(values)).min()) if len(np.unique(values)) > 1 else 1.0


def save(figure: Figure, path: str | Path) -> Path:
    """Write a PNG atomically."""
    with atomic(path) as file:
        figure.savefig(file, dpi=130, facecolor="white")
    return Path(path)


def _edges(centres: Array) -> Array:
    """Return the edges of cells: halfway between two centres, and as far beyond the outer ones; (n + 1,)."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middles = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[2 * centres[0] - middles[0]], middles, [2 * centres[-1] - middles[-1]]])


def _label_cells(axis: Axes, mesh: QuadMesh, x: Array, y: Array, values: Array) -> None:
    size = 7 if max(values.shape) <= 9 else 6
    for i, j in np.argwhere(np.isfinite(values)):
        light = np.dot(mesh.to_rgba(values[i, j])[:3], _LUMINANCE) > 0.5
        colour = "black" if light else "white"
        axis.text(x[i], y[j], short(values[i, j]), ha="center", va="center", fontsize=size, color=colour)


def short(value: float) -> str:
    """Format a non-negative number with about two digits.

    Example:
        >>> [short(value) for value in (0.0, 0.004, 0.123, 1.0, 3.21, 12.3)]
        ['0', '0.00', '0.12', '1.0', '3.2', '12']
    """
    if value == 0:
        return "0"
    return f"{value:.{2 if value < 0.995 else 1 if value < 9.95 else 0}f}"

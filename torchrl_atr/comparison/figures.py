"""Figures of a comparison. Importing this module imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from numpy.typing import NDArray

from torchrl_atr.comparison.summary import by_history
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.plotting import GREY, STYLE, save, subplots

_COLOURS = "tab10"


def plot_components(estimators: Mapping[str, Any], path: str | Path) -> Path:
    """Plot 1 - R² of each extrinsic state as bars, one for each estimator, with 95 % intervals.

    Args:
        estimators: by name, of :func:`~torchrl_atr.comparison.summarize`; those without errors are left out.
        path: the PNG to write.
    """
    rows = {name: row for name, row in estimators.items() if "error" in row}
    labels = [component["label"] for component in next(iter(rows.values()))["components"]]
    height = 0.8 / len(rows)
    with rc_context(STYLE):
        figure, axis = subplots(figsize=(7.5, 1.2 + (0.16 * len(rows) + 0.12) * len(labels)))
        for number, (name, row) in enumerate(rows.items()):
            value, low, high = (1.0 - _column(row["components"], end) for end in ("value", "high", "low"))
            at = np.arange(len(labels)) + (number - (len(rows) - 1) / 2) * height
            colour = colormaps[_COLOURS](number % 10)
            axis.barh(at, value, height, color=colour, label=name)
            axis.hlines(at, low, high, color=GREY, lw=1.0)
        axis.set_yticks(range(len(labels)), labels)
        axis.margins(y=0.01)
        axis.invert_yaxis()
        axis.axvline(1.0, color=GREY, lw=0.8, ls=":")
        axis.set(xlabel="share of the variance that is not explained, 1 - R²", xlim=(0.0, _most(rows)))
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return save(figure, path)


def _column(components: list[Any], end: str) -> NDArray[np.float64]:
    return np.array([component["r_squared"][end] for component in components], dtype=np.float64)


def _most(rows: Mapping[str, Any]) -> float:
    """Return the end of the axis: 1 is an estimator that knows the mean alone, and far worse ones are cut off."""
    values = np.concatenate([1.0 - _column(row["components"], "value") for row in rows.values()])
    known = values[np.isfinite(values)]
    return float(np.clip(1.1 * known.max(), 0.05, 2.0)) if known.size else 1.0


def plot_drift(estimators: Mapping[str, Any], path: str | Path) -> Path:
    """Plot the error over all extrinsic states against the time in the ride, with 95 % intervals as bands.

    Args:
        estimators: as for :func:`plot_components`.
        path: the PNG to write.
    """
    with rc_context(STYLE):
        figure, axis = subplots(figsize=(7.5, 4.0))
        rows = {name: row for name, row in estimators.items() if "error" in row}
        for number, (name, row) in enumerate(rows.items()):
            drift, x = row["drift"], row["drift"]["seconds"]
            _band(axis, x, drift, number, label=name, marker="." if len(x) == 1 else None)
        axis.set(xlabel="time in the ride [s]", ylabel="error [standard deviations]", ylim=(0.0, None))
        axis.grid(alpha=0.25)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return save(figure, path)


def plot_history(estimators: Mapping[str, Any], path: str | Path) -> Path:
    """Plot the errors of the extrinsic states and of the latent against the length of the history, with 95 % intervals.

    Args:
        estimators: as for :func:`plot_components`; those of a single length are left out.
        path: the PNG to write.
    """
    with rc_context(STYLE):
        figure, axes = subplots(1, 2, figsize=(9.0, 3.6))
        for number, (name, rows) in enumerate(by_history(estimators).items()):
            seconds = CONTROL_DT * np.array([row["history_length"] for row in rows])
            for axis, found in zip(axes, ([row["error"] for row in rows], [row["latent"]["rmse"] for row in rows])):
                curve = {end: [each[end] for each in found] for end in ("value", "low", "high")}
                _band(axis, seconds, curve, number, label=name, marker=".")
        for axis, what in zip(axes, ("extrinsic states [standard deviations]", "latent [norm]")):
            axis.set(title=f"error of the {what}", xlabel="history [s]", ylim=(0.0, None))
            axis.grid(alpha=0.25)
        axes[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return save(figure, path)


def _band(axis: Axes, x: Any, curve: Mapping[str, Any], number: int, **line: Any) -> None:
    """Draw the ``value`` of a curve over x in the colour of a number, and a band from ``low`` to ``high``."""
    value, low, high = (np.array(curve[end], dtype=np.float64) for end in ("value", "low", "high"))
    colour = colormaps[_COLOURS](number % 10)
    axis.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
    axis.plot(x, value, color=colour, lw=1.5, **line)

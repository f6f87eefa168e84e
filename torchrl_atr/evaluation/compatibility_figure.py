"""Figure of a compatibility evaluation, as a PNG file. Importing this module imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context

from torchrl_atr.evaluation.intervals import share_text
from torchrl_atr.evaluation.plotting import GREY, SHARES, STYLE, hatch_handle, save, subplots

_DARK = 0.55
"""Share below which text is white."""


def plot_compatibility(metrics: Mapping[str, Any], path: str | Path) -> Path:
    """Plot the share of robots up at the end, robots down the side and transporters along the top.

    Args:
        metrics: of :func:`~torchrl_atr.evaluation.compatibility.evaluate_compatibility`.
        path: the PNG to write.
    """
    cells, trained_on = metrics["cells"], metrics["trained_on"]
    robots, transporters = (list(dict.fromkeys(cell[name] for cell in cells)) for name in ("robot", "transporter"))
    shares = np.full((len(robots), len(transporters)), np.nan)
    with rc_context(STYLE):
        figure, axis = subplots(figsize=(1.9 * len(transporters) + 2.2, 1.1 * len(robots) + 1.4))
        for cell in cells:
            row, column = robots.index(cell["robot"]), transporters.index(cell["transporter"])
            shares[row, column] = up = cell.get("survival", np.nan)
            colour = "white" if up < _DARK else "black"
            axis.text(column, row, _text(cell), ha="center", va="center", fontsize=8, color=colour)
        axis.set_facecolor("0.95")
        mesh = axis.imshow(np.ma.masked_invalid(shares), cmap=SHARES, vmin=0.0, vmax=1.0, aspect="auto")
        axis.set_xticks(range(len(transporters)), [_named(name, trained_on["transporter"]) for name in transporters])
        axis.set_yticks(range(len(robots)), [_named(name, trained_on["robot"]) for name in robots])
        axis.spines[:].set_visible(False)
        figure.colorbar(mesh, ax=axis, label=f"share up after {metrics.get('seconds', 0):g} s")
        if np.isnan(shares).any():
            axis.legend(handles=[hatch_handle("not measured, or cannot")], loc="upper left", bbox_to_anchor=(0, -0.15))
        text = "* trained on; errors: speed [m/s], yaw rate [rad/s]"
        figure.supxlabel(text, fontsize=8, color=GREY, x=0.01, ha="left")
        return save(figure, path)


def _named(name: str, own: str) -> str:
    return f"{name}*" if name == own else name


def _text(cell: Mapping[str, Any]) -> str:
    if "refused" in cell:
        return "cannot"
    errors = [cell["settled_speed_error"], cell["settled_yaw_error"]]
    second = ", ".join("-" if error is None else f"{error:.2f}" for error in errors)
    return f"{share_text(cell['survival'], cell['survival_interval'])}\n{second}"

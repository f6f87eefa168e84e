"""Figure of the commands that a robot on a transporter can follow at all. Importing this module imports matplotlib."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.lines import Line2D

from torchrl_atr.envs.tasks.state import GRAVITY
from torchrl_atr.evaluation.envelope import Envelope
from torchrl_atr.evaluation.plotting import SHARES, STYLE, save, subplots

_LEANS = (0, 5, 10, 15, 20, 25, 30, 35, 40, 45)


def plot_envelope(envelope: Envelope, path: str | Path, max_speed: float = 15.0, max_yaw_rate: float = 2.0) -> Path:
    """Plot the lean that steady turns need, up to where the feet slip, and where turning pays under the reward.

    Args:
        envelope: of a task.
        path: the PNG to write.
        max_speed: largest |v| of the figure, m/s.
        max_yaw_rate: largest |ω| of the figure, rad/s.
    """
    speeds, yaw_rates = np.linspace(-max_speed, max_speed, 601), np.linspace(-max_yaw_rate, max_yaw_rate, 401)
    lateral = np.abs(np.outer(yaw_rates, speeds))
    held = lateral <= envelope.friction * GRAVITY
    lean = np.ma.masked_where(~held, np.degrees(np.arctan(lateral / GRAVITY)))
    pays = envelope.follows(speeds, yaw_rates, error=0.0).T
    with rc_context(STYLE):
        figure, axis = subplots(figsize=(7.2, 3.2))
        colours = axis.contourf(speeds, yaw_rates, lean, _LEANS, cmap=SHARES, extend="max")
        axis.contour(speeds, yaw_rates, held.astype(float), [0.5], colors="black", linewidths=1.6)
        axis.contour(speeds, yaw_rates, pays.astype(float), [0.5], colors="black", linewidths=1.2, linestyles=":")
        axis.set(xlabel="forward speed v [m/s]", ylabel="yaw rate ω [rad/s]")
        figure.colorbar(colours, ax=axis, label="inward lean, arctan(|v ω| / g) [°]")
        handles = [
            Line2D([], [], color="black", lw=1.6, label=f"the feet hold: |v ω| = μ g, μ = {envelope.friction:g}"),
            Line2D([], [], color="black", lw=1.2, ls=":", label="turning pays under the reward"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
        return save(figure, path)

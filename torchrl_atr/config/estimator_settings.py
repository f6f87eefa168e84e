"""Settings of the estimators."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torchrl_atr._settings import Settings, setting

_TINY = 1e-12


@dataclass(frozen=True)
class EstimatorConfig(Settings):
    """Estimators of intrinsic and extrinsic state."""

    group = "estimator"

    name: str = setting("cnn_gru", question="A26", alias="estimator")
    """A registered estimator: `list estimators`. Table I."""
    arguments: dict[str, Any] = setting({})
    """Arguments of its factory, such as gru_features."""
    shared: bool = setting(False)
    """Let one estimator infer both z and x_ext. Table I has two."""
    actor_reads_scale: bool = setting(False)
    """Let the actor also read the standard deviations of the estimates; the estimator must give them, as gaussian."""
    learning_rate: float = setting(1e-3, within=(_TINY, 1))
    """Learning rate of both, fixed."""
    epochs: int = setting(1, within=(0, 1000))
    """Passes over a batch; with 0, estimators stay as they are."""
    dead_reckoning: bool = setting(True, off=False, addition="dead-reckoned velocity")
    """Let the extrinsic estimator also read the dead-reckoned velocity, see task.velocity_filter. 0.2 s of history sees
    speed only through the resistance: 0.06 m/s² for each m/s."""
    normalize_targets: bool = setting(
        True, question="A25", off=False, addition="normalised targets of the extrinsic estimator"
    )
    """Measure errors of x_ext in standard deviations. Eq. 16 sums squared errors of contacts (0 or 1), velocities (up
    to 15 m/s) and positions alike; measured like this each counts."""

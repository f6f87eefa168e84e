"""Figures of rides: the spread between trainings is in their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from torchrl_atr.comparison.rides import ride_figures
from torchrl_atr.evaluation import EnduranceResult

N, SECONDS = 50, 4


def ridden(up: float, error: float) -> EnduranceResult:
    """Return rides of which a share stays up, all with the same error."""
    fallen = np.arange(N) >= round(up * N)
    return EnduranceResult(
        commands=np.zeros((1, N, 2)),
        fall_time=np.where(fallen, 2.0, np.nan),
        fall_cause=np.where(fallen, "tilted", ""),
        since_push=np.full(N, np.nan),
        since_command=np.where(fallen, 2.0, np.nan),
        up_steps=np.full((SECONDS, N), 50),
        settled_steps=np.full((SECONDS, N), 50),
        settled_error=np.full((SECONDS, N, 2), [error, 2.0 * error]),
        intrinsics=np.zeros((N, 0)),
        intrinsic_names=(),
        estimate_error=None,
        components=(),
        latent_error=None,
        seconds=float(SECONDS),
        command_seconds=4.0,
        settle=0.0,
        bounds=np.array([[-2.0, -1.0], [2.0, 1.0]]),
        push_seconds=3.0,
        overspeed=(2.0, 2.0),
        dt=0.02,
        policy_reads=("observation",),
    )


def test_trainings_that_differ_widen_the_intervals():
    alike = ride_figures([ridden(0.8, 0.3)] * 3)
    apart = ride_figures([ridden(1.0, 0.1), ridden(1.0, 0.1), ridden(0.4, 0.7)])
    assert alike["survival"] == apart["survival"] == pytest.approx(0.8)
    assert alike["settled_speed_error"] == apart["settled_speed_error"] == pytest.approx(0.3)
    low, high = apart["survival_interval"]
    assert low < 0.5 < 0.99 < high < 1.01
    assert alike["survival_interval"][0] > 0.7
    assert alike["settled_yaw_error_interval"] == pytest.approx([0.6, 0.6])
    assert apart["settled_yaw_error_interval"] == pytest.approx([0.2, 1.4])


def test_of_one_training_without_a_fall_the_interval_is_wilsons():
    figures = ride_figures([ridden(1.0, 0.1)])
    assert figures["survival_interval"] == pytest.approx([0.929, 1.0], abs=1e-3)

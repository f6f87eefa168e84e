"""Statistics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from torchrl_atr.comparison.statistics import (
    LinearProbe,
    effective_dimension,
    interval,
    pooled_r_squared,
    r_squared,
    rmse,
)

DRAW = np.random.default_rng(0)


def test_r_squared_is_that_of_its_definition():
    truth, error = DRAW.normal(2.0, 3.0, (100, 2)), DRAW.normal(0.0, 1.0, (100, 2))
    sums = (error**2).sum(0), np.array([100.0]), truth.sum(0), (truth**2).sum(0)
    np.testing.assert_allclose(r_squared(*sums), 1 - (error**2).mean(0) / truth.var(0))
    assert pooled_r_squared(*sums) == pytest.approx(1 - (error**2).mean(0).sum() / truth.var(0).sum())


def test_a_target_that_does_not_vary_has_no_r_squared():
    truth = np.stack([np.full(50, 0.1), DRAW.normal(size=50)], -1)
    sums = np.ones(2), np.array([50.0]), truth.sum(0), (truth**2).sum(0)
    assert np.isnan(r_squared(*sums)).tolist() == [True, False]
    assert np.isfinite(pooled_r_squared(*sums))
    assert np.isnan(pooled_r_squared(*[each[..., :1] for each in sums]))


def drawn(trainings, robots, between_trainings):
    """Squared errors of a two-way random-effects model: they differ between trainings and between robots."""
    spread = DRAW.normal(0, between_trainings, (trainings, 1)) + DRAW.normal(0, 0.5, (1, robots))
    return (2.0 + spread) ** 2, np.ones((trainings, robots))


def width(sums):
    figure = interval(rmse, *sums)
    return figure["high"] - figure["low"]


def test_intervals_hold_the_true_value():
    truth = np.sqrt(4.0 + 0.25 + 0.01)
    held = [interval(rmse, *drawn(5, 40, 0.1), seed=seed) for seed in range(60)]
    assert sum(each["low"] <= truth <= each["high"] for each in held) >= 50


def test_intervals_shrink_with_the_robots_and_grow_with_the_spread_of_trainings():
    assert width(drawn(1, 4000, 0.0)) == pytest.approx(width(drawn(1, 40, 0.0)) / 10, rel=0.3)
    assert width(drawn(3, 4000, 1.0)) > 5 * width(drawn(3, 4000, 0.0))


def test_one_robot_has_no_interval():
    figure = interval(rmse, np.ones((3, 1, 2)), np.ones((3, 1, 1)))
    assert figure["value"].tolist() == [1.0, 1.0]
    assert np.isnan(figure["low"]).all()


def test_the_probe_of_a_noisy_linear_map_explains_what_theory_says():
    x = DRAW.normal(size=(20_000, 3))
    y = np.stack([x @ [1.0, -2.0, 0.0] + DRAW.normal(0, 2.0, 20_000), DRAW.normal(size=20_000)], -1)
    error = LinearProbe(x[:10_000], y[:10_000])(x[10_000:]) - y[10_000:]
    explained = 1 - error.var(0) / y[10_000:].var(0)
    np.testing.assert_allclose(explained, [5 / 9, 0.0], atol=0.02)


def test_the_effective_dimension_counts_directions():
    x = DRAW.normal(size=(50_000, 4))
    assert effective_dimension(x) == pytest.approx(4.0, rel=0.01)
    assert effective_dimension(x * [1.0, 1.0, 0.0, 0.0]) == pytest.approx(2.0, rel=0.01)
    assert effective_dimension(x * [2.0, 1.0, 0.0, 0.0]) == pytest.approx(25 / 17, rel=0.02)
    assert effective_dimension(np.ones((5, 2))) == 0.0

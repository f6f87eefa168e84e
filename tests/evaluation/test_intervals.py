import numpy as np
import pytest

from torchrl_atr.evaluation.intervals import bootstrap, bootstrap_difference, pooled_mean, welch_difference, wilson


@pytest.mark.parametrize(("count", "n"), [(0, 20), (51, 100), (200, 200), (1, 3)])
def test_wilson_by_its_closed_form(count, n):
    z, share = 1.959963984540054, count / n
    middle = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    assert wilson(count, n) == pytest.approx((middle - half, middle + half), abs=1e-12)


def test_without_trials_nothing_is_known():
    assert wilson(0, 0) == (0.0, 1.0)
    assert np.isnan(pooled_mean(np.zeros(3), np.zeros(3)))


def test_a_pooled_mean_weighs_robots_by_their_steps():
    assert pooled_mean(np.array([[1.0, 9.0]]), np.array([[1.0, 3.0]])) == [2.5]


def test_the_bootstrap_of_many_robots_is_near_the_normal_interval():
    values = np.random.default_rng(0).normal(3.0, 1.0, size=(2, 400))
    low, high = bootstrap(values, np.ones_like(values))
    half = 1.96 * values.std(-1) / 20
    np.testing.assert_allclose(low, values.mean(-1) - half, atol=0.03)
    np.testing.assert_allclose(high, values.mean(-1) + half, atol=0.03)
    again = bootstrap(values, np.ones_like(values))
    np.testing.assert_array_equal(again, (low, high))


def test_one_robot_has_no_interval():
    assert np.isnan(bootstrap(np.ones((2, 1)), np.ones((2, 1)))).all()


def test_few_robots_among_many_have_an_interval():
    """Three of two hundred are still up, which one draw in twenty misses."""
    sums, counts = np.zeros(200), np.zeros(200)
    sums[:3], counts[:3] = [1.0, 2.0, 3.0], 1.0
    low, high = bootstrap(sums, counts)
    assert 1.0 <= low < 2.0 < high <= 3.0
    assert np.isnan(bootstrap(np.zeros(5), np.zeros(5))).all()
    assert bootstrap(np.zeros((0, 2, 5)), np.zeros((0, 2, 5)))[0].shape == (0, 2)


def test_the_bootstrap_of_a_difference_divides_each_sample_by_its_own_size():
    difference, interval = bootstrap_difference(np.full(2, 2.0), np.full(5, 1.0))
    assert (difference, *interval) == pytest.approx((1.0, 1.0, 1.0))


def test_welchs_interval_of_unequal_samples_by_hand():
    """Squared errors of the means are 1/2 and 1: (1/2 + 1)² / ((1/2)²/1 + 1²/2) is 3 degrees of freedom."""
    difference, interval = welch_difference(5.0 + np.sqrt(0.5) * np.array([-1.0, 1.0]), np.array([0.0, 0.0, 3.0]))
    half = 3.182446305 * np.sqrt(1.5)
    assert difference == pytest.approx(4.0)
    assert interval == pytest.approx((4.0 - half, 4.0 + half))

"""95 % confidence intervals of shares and of means over robots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]
LEVEL = 0.95
RESAMPLES = 1000
"""Number of resamples of a bootstrap."""


def wilson(count: int, n: int) -> tuple[float, float]:
    """Compute Wilson's score interval of a share; (0, 1) without any trial.

    Args:
        count: successes.
        n: independent trials.

    Example:
        >>> [round(end, 3) for end in wilson(51, 100)]
        [0.413, 0.606]
    """
    if n == 0:
        return 0.0, 1.0
    interval = stats.binomtest(count, n).proportion_ci(LEVEL, method="wilson")
    return float(interval.low), float(interval.high)


def pooled_mean(sums: Array, counts: Array) -> Array:
    """Compute the mean over all steps of all robots, (...); NaN without steps.

    Args:
        sums: of each robot over its steps, (..., n).
        counts: number of those steps, (..., n).

    Example:
        >>> float(pooled_mean(np.array([1.0, 4.0]), np.array([1.0, 4.0])))
        1.0
    """
    total, count = sums.sum(-1), counts.sum(-1)
    return np.divide(total, count, out=np.full(np.shape(total), np.nan), where=count > 0)


def bootstrap(sums: Array, counts: Array, seed: int = 0) -> tuple[Array, Array]:
    """Compute the ends of the percentile bootstrap interval of :func:`pooled_mean`, (...) each; NaN for one robot.

    Robots are resampled with all of their steps, since these are correlated. Resamples without any step are left out,
    which ``scipy.stats.bootstrap`` cannot do: it would have no interval where few robots are still up.

    Args:
        sums: of each robot over its steps, (..., n).
        counts: number of those steps, (..., n).
        seed: of the resamples.

    Example:
        >>> low, high = bootstrap(np.array([1.0, 1.0, 1.0]), np.array([2.0, 2.0, 2.0]))
        >>> float(low), float(high)
        (0.5, 0.5)
    """
    n = sums.shape[-1]
    draws = np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES).astype(np.float64)
    total, count = sums @ draws.T, counts @ draws.T
    means = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    known = (counts > 0).sum(-1) > 1  # one robot says nothing about others
    filled = np.where(known[..., None], means, 0.0)
    low, high = (np.nanquantile(filled, (1.0 + sign * LEVEL) / 2.0, axis=-1) for sign in (-1, 1))
    return np.where(known, low, np.nan), np.where(known, high, np.nan)


def bootstrap_difference(
    values: Array, others: Array, paired: bool = False, seed: int = 0
) -> tuple[float, tuple[float, float] | None]:
    """Compute the mean of ``values`` minus that of ``others``, and its percentile bootstrap interval.

    Args:
        values: of one sample, (n,).
        others: of the other, (m,); if ``paired`` of the same robots or paths, (n,), which are then resampled together.
        paired: whether the values belong together.
        seed: of the resamples.

    Returns:
        The difference, NaN without any value, and its interval, None for less than two values of either.

    Example:
        >>> bootstrap_difference(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 2.0]), paired=True)
        (1.0, (1.0, 1.0))
    """
    if paired:
        values, others = values - others, np.zeros(len(values))
    if not len(values) or not len(others):
        return np.nan, None
    difference = float(values.mean() - others.mean())
    if min(len(values), len(others)) < 2:
        return difference, None
    generator = np.random.default_rng(seed)
    means = [
        generator.multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES) @ sample / n
        for sample in (values, others)
        for n in [len(sample)]
    ]
    low, high = np.quantile(means[0] - means[1], [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    return difference, (float(low), float(high))


def welch_difference(values: Array, others: Array) -> tuple[float, tuple[float, float] | None]:
    """Compute the mean of ``values`` minus that of ``others``, and Welch's t interval, for samples of a few.

    A percentile bootstrap of three values has their ends as its own, and covers the truth in three of four cases.

    Args:
        values: of one sample, such as a figure of each seed, (n,).
        others: of the other, (m,).

    Returns:
        The difference, and its interval, None for less than two values of either.

    Example:
        >>> difference, (low, high) = welch_difference(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 2.0]))
        >>> difference, round(low, 2), round(high, 2)
        (1.0, -1.27, 3.27)
    """
    difference = float(values.mean() - others.mean())
    if min(len(values), len(others)) < 2:
        return difference, None
    if not values.var() + others.var():
        return difference, (difference, difference)
    interval = stats.ttest_ind(values, others, equal_var=False).confidence_interval(LEVEL)
    return difference, (float(interval.low), float(interval.high))


def mean_interval(values: Array) -> tuple[float, tuple[float, float] | None]:
    """Compute the mean of independent values, NaN without any, and its bootstrap interval, None for less than two.

    Example:
        >>> mean_interval(np.array([2.0, 2.0]))
        (2.0, (2.0, 2.0))
    """
    return bootstrap_difference(values, np.zeros(len(values)), paired=True)


def share_text(share: float, interval: Sequence[float]) -> str:
    """Return a share and its interval as text.

    Example:
        >>> share_text(0.9, (0.84, 0.95))
        '90% [84%, 95%]'
    """
    low, high = interval
    return f"{share:.0%} [{low:.0%}, {high:.0%}]"

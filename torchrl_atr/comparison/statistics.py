"""Statistics of a comparison: intervals over robots and trainings, a linear probe, the effective dimension."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchrl_atr.evaluation.intervals import LEVEL, RESAMPLES

Array = NDArray[np.float64]
PENALTY = 1e-4
"""Penalty of the ridge regression, in units of the inputs' variance."""


def rmse(squared: Array, steps: Array) -> Array:
    """Compute root mean squares from sums of squares and numbers of steps.

    Example:
        >>> float(rmse(np.array(8.0), np.array(2.0)))
        2.0
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(squared / steps)


def r_squared(squared: Array, steps: Array, total: Array, total_squared: Array) -> Array:
    """Compute R², the share of the targets' variance that is explained; NaN for targets that do not vary.

    Args:
        squared: sums of squared errors.
        steps: numbers of steps.
        total: sums of the targets.
        total_squared: sums of their squares.

    Example:
        >>> float(r_squared(np.array(1.0), np.array(4.0), np.array(0.0), np.array(4.0)))
        0.75
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return 1.0 - squared / _variation(steps, total, total_squared)


def _variation(steps: Array, total: Array, total_squared: Array) -> Array:
    """Return sums of squared distances from the mean; NaN where rounding alone is left."""
    variation = total_squared - total**2 / steps
    return np.where(variation > 1e-9 * total_squared, variation, np.nan)


def pooled_r_squared(squared: Array, steps: Array, total: Array, total_squared: Array) -> Array:
    """Compute R² of all targets together, the share of their total variance, from sums as for :func:`r_squared`.

    Example:
        >>> squared, steps, total, total_squared = np.array([[1.0, 3.0], [4.0] * 2, [0.0] * 2, [4.0] * 2])
        >>> float(pooled_r_squared(squared, steps, total, total_squared))
        0.5
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        variation = _variation(steps, total, total_squared)
        varies = np.isfinite(variation)
        of_all = np.where(varies, variation, 0.0).sum(-1)
        return np.where(varies.any(-1), 1.0 - squared.sum(-1) / of_all, np.nan)


def interval(statistic: Callable[..., Array], *sums: Array, same_robots: bool = True, seed: int = 0) -> dict[str, Any]:
    """Return a statistic of sums over all trainings and robots, and its 95 % interval.

    Both trainings and robots are resampled, each with all of its steps (percentile bootstrap). One training leaves the
    spread between trainings out; of one robot there is no interval.

    Args:
        statistic: a function of the summed arrays, with any leading dimensions.
        *sums: by training and robot, (S, n, ...), with as many dimensions each.
        same_robots: whether all trainings have the same robots, which are then resampled alike.
        seed: of the resamples.

    Returns:
        ``value``, ``low`` and ``high``, (...).

    Example:
        >>> squared, steps = np.full((3, 5), 8.0), np.full((3, 5), 2.0)
        >>> {name: float(value) for name, value in interval(rmse, squared, steps).items()}
        {'value': 2.0, 'low': 2.0, 'high': 2.0}
    """
    trainings, robots = sums[0].shape[:2]
    draw = np.random.default_rng(seed)
    of_trainings, of_robots = (
        draw.multinomial(n, np.full(n, 1.0 / n), size=(RESAMPLES, times))
        for n, times in ((trainings, 1), (robots, 1 if same_robots else trainings))
    )
    weight = (of_trainings.swapaxes(1, 2) * of_robots).reshape(RESAMPLES, -1).astype(np.float64)
    value = statistic(*[each.sum((0, 1)) for each in sums])
    drawn = statistic(*[np.tensordot(weight, each.reshape(-1, *each.shape[2:]), 1) for each in sums])
    if robots == 1:
        return {"value": value, "low": np.full_like(value, np.nan), "high": np.full_like(value, np.nan)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a target that varies in no resample
        low, high = (np.nanquantile(drawn, (1.0 + sign * LEVEL) / 2.0, axis=0) for sign in (-1, 1))
    return {"value": value, "low": low, "high": high}


class LinearProbe:
    """Ridge regression of targets on inputs: what of the targets can be read from the inputs linearly.

    Args:
        inputs: (M, L).
        targets: (M, I).
        penalty: in units of the inputs' variance.

    Example:
        >>> x = np.random.default_rng(0).normal(size=(100, 2))
        >>> LinearProbe(x, x @ [[2.0], [1.0]])(np.array([[1.0, 1.0]])).round(2).tolist()
        [[3.0]]
    """

    def __init__(self, inputs: Array, targets: Array, penalty: float = PENALTY) -> None:
        self._mean, self._offset = inputs.mean(0), targets.mean(0)
        scale = inputs.std(0)
        self._scale = np.where(scale > 0, scale, 1.0)
        x, y = self._standardised(inputs), targets - self._offset
        self._weights = np.linalg.solve(x.T @ x / len(x) + penalty * np.eye(x.shape[1]), x.T @ y / len(x))

    def __call__(self, inputs: Array) -> Array:
        """Predict the targets of inputs, (*B, L) to (*B, I)."""
        return self._standardised(inputs) @ self._weights + self._offset

    def _standardised(self, inputs: Array) -> Array:
        return (inputs - self._mean) / self._scale


def effective_dimension(samples: Array) -> float:
    """Compute the participation ratio of the covariance's eigenvalues, (Σλ)² / Σλ²: L if all directions vary alike.

    Args:
        samples: (M, L).

    Example:
        >>> round(effective_dimension(np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])), 6)
        2.0
    """
    covariance = np.atleast_2d(np.cov(samples.T))
    squares = float((covariance**2).sum())
    return float(np.trace(covariance)) ** 2 / squares if squares > 0 else 0.0

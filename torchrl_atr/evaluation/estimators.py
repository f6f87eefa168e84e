"""Errors of the two estimators while the policy rides on them (paper, Table V)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from torchrl_atr.evaluation.access import Component
from torchrl_atr.modules.keys import NetworkKeys

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimationErrors:
    """First and second moments of the errors of each trial, over the steps that it was up; SI units.

    ``*T`` is the shape of the trials: (V, W, R) in tracking; (S, n), seconds and robots, in endurance.

    Attributes:
        steps: number of those steps, (*T).
        components: the E extrinsic states.
        extrinsic: mean |x̂ - x| of each state, (*T, E).
        extrinsic_squared: mean |x̂ - x|², (*T, E).
        latent: mean ‖ẑ - z‖, (*T); None without an encoder.
        latent_squared: mean ‖ẑ - z‖², (*T).
    """

    steps: Array
    components: tuple[Component, ...]
    extrinsic: Array
    extrinsic_squared: Array
    latent: Array | None = None
    latent_squared: Array | None = None

    @staticmethod
    def join(parts: Sequence[EstimationErrors | None], shape: tuple[int, ...]) -> EstimationErrors | None:
        """Concatenate the parts' trials as ``shape``, (*T); None if any part is None."""
        known = [part for part in parts if part is not None]
        if not known or len(known) < len(parts):
            return None

        def joined(name: str) -> Array | None:
            values = [getattr(part, name) for part in known]
            if any(value is None for value in values):
                return None
            together = np.concatenate(values)
            return together.reshape(*shape, *together.shape[1:])

        fields = ("steps", "extrinsic", "extrinsic_squared", "latent", "latent_squared")
        return EstimationErrors(components=known[0].components, **{name: joined(name) for name in fields})  # type: ignore[arg-type]

    def moments(self) -> tuple[tuple[float, float] | None, list[tuple[Component, float, float]]]:
        """Compute mean and standard deviation over all steps of all trials: latent, and each extrinsic state.

        Example:
            >>> moments = np.array([[[[0.1, 0.2]]]])
            >>> components = Component("a", "a", "m"), Component("b", "b", "m")
            >>> errors = EstimationErrors(np.ones((1, 1, 1)), components, moments, moments**2)
            >>> [(component.name, mean) for component, mean, _ in errors.moments()[1]]
            [('a', 0.1), ('b', 0.2)]
        """
        pooled = self._pool(self.extrinsic), self._pool(self.extrinsic_squared)
        extrinsic = [(component, *_spread(m, s)) for component, m, s in zip(self.components, *pooled)]
        if self.latent is None or self.latent_squared is None:
            return None, extrinsic
        return _spread(float(self._pool(self.latent)), float(self._pool(self.latent_squared))), extrinsic

    def _pool(self, values: Array) -> Array:
        weights = self.steps / self.steps.sum()
        return np.tensordot(weights, values, axes=weights.ndim)


def _spread(mean: float, square: float) -> tuple[float, float]:
    return float(mean), float(np.sqrt(max(square - mean**2, 0.0)))


class EstimatorSums:
    """Accumulator of the estimation errors of n robots.

    Args:
        n: number of robots.
        encoder: reads the env's privileged entries and writes the true latent; None to leave the latent out.
        keys: names of the entries.
        components: returns the extrinsic states, given their number.
    """

    def __init__(
        self,
        n: int,
        encoder: TensorDictModuleBase | None,
        keys: NetworkKeys,
        components: Callable[[int], tuple[Component, ...]],
    ) -> None:
        self._encoder, self._keys, self._components = encoder, keys, components
        self._steps = torch.zeros(n, dtype=torch.float64)
        self._sums: dict[str, Tensor] = {}

    def add(self, observed: TensorDictBase, decided: TensorDictBase, alive: Tensor) -> None:
        """Add one step: the env's true states, the policy's estimates, and a mask of the robots that count, (n,)."""
        keys = self._keys
        self._steps += alive
        truth, estimate = observed.get(keys.extrinsic, None), decided.get(keys.extrinsic_estimate, None)
        if truth is not None and estimate is not None:
            self._accumulate("extrinsic", (estimate - truth).abs(), alive)
        estimate = decided.get(keys.intrinsic_estimate, None)
        if self._encoder is not None and estimate is not None:
            latent = self._encoder(observed.select(*self._encoder.in_keys)).get(keys.latent)
            self._accumulate("latent", (estimate - latent).norm(dim=-1), alive)

    def _accumulate(self, name: str, error: Tensor, alive: Tensor) -> None:
        mask = alive.reshape(-1, *[1] * (error.ndim - 1))
        error = torch.where(mask, error.double(), torch.zeros((), dtype=torch.float64))
        for key, value in ((name, error), (f"{name}_squared", error**2)):
            self._sums[key] = self._sums.get(key, torch.zeros_like(value)) + value

    def result(self) -> EstimationErrors | None:
        """Return the mean errors of each robot; None without an estimate whose true value the env emits."""
        if "extrinsic" not in self._sums:
            return None
        means = {
            name: (value / self._steps.reshape(-1, *[1] * (value.ndim - 1))).numpy()
            for name, value in self._sums.items()
        }
        components = self._components(means["extrinsic"].shape[-1])
        return EstimationErrors(steps=self._steps.numpy(), components=components, **means)

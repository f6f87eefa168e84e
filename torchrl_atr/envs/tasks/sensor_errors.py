"""Errors of sensors: noise, bias and delay of observation terms."""

from __future__ import annotations

import torch
from tensordict import NestedKey
from torch import Tensor

from torchrl_atr.envs.tasks.observation_terms import Observations


class SensorErrors:
    """Adds the errors that observation terms declare; each robot has a bias and a delay of its own for an episode.

    Args:
        observations: the groups; those without an error are left alone.
        num_envs: N.
        generator: source of randomness.

    Attributes:
        state: biases, delays and the values of the step before, by key, (N, D) each.
    """

    def __init__(self, observations: Observations, num_envs: int, generator: torch.Generator) -> None:
        self.generator = generator
        self._scales: dict[NestedKey, Tensor] = {}  # noise, bias and delay of every component, (3, D)
        self.state: dict[str, Tensor] = {}
        for key, group in observations.groups.items():
            if any(term.sensed for term in group.values()):
                sizes = torch.tensor(list(observations.sizes[key].values()))
                scales = torch.tensor([[t.noise, t.bias, t.delay] for t in group.values()], dtype=torch.float32)
                self._scales[key] = scales.repeat_interleave(sizes, 0).T
                for name in ("bias", "delayed", "before"):
                    self.state[_name(key, name)] = torch.zeros(num_envs, int(sizes.sum()), dtype=torch.float32)

    def __bool__(self) -> bool:
        return bool(self._scales)

    def start(self, rows: Tensor, observed: dict[NestedKey, Tensor]) -> dict[NestedKey, Tensor]:
        """Draw biases and delays for episodes of ``rows`` (n,) that start; return what they observe, (n, D) by key."""
        sensed = dict(observed)
        for key, (noise, bias, delay) in self._scales.items():
            value = observed[key]
            draw = torch.randn(value.shape, generator=self.generator, dtype=torch.float32)
            drawn = torch.rand(len(rows), 1, generator=self.generator, dtype=torch.float32)
            for name, fresh in (("bias", bias * draw), ("delayed", (drawn < delay).float()), ("before", value)):
                self.state[_name(key, name)][rows] = fresh
            sensed[key] = value + bias * draw + self._noise(noise, value)
        return sensed

    def apply(self, observed: dict[NestedKey, Tensor]) -> dict[NestedKey, Tensor]:
        """Return what all robots observe after a step, (N, D) by key, given the true values."""
        sensed = dict(observed)
        for key, (noise, _, _) in self._scales.items():
            value, before = observed[key], self.state[_name(key, "before")]
            late = torch.where(self.state[_name(key, "delayed")] > 0, before, value)
            sensed[key] = late + self.state[_name(key, "bias")] + self._noise(noise, value)
            self.state[_name(key, "before")] = value.clone()
        return sensed

    def _noise(self, scale: Tensor, like: Tensor) -> Tensor:
        return scale * torch.randn(like.shape, generator=self.generator, dtype=torch.float32)


def _name(key: NestedKey, name: str) -> str:
    return f"{name} of {key if isinstance(key, str) else '/'.join(key)}"

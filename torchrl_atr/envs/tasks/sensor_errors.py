"""Errors of sensors: noise, bias and delay of observation terms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor

from torchrl_atr.envs.physics.engine import CONTROL_DT

_ERRORS = ("noise", "bias", "bias_time", "delay")
Draw = dict[str, Tensor]
"""``offset`` and ``delay`` of a group's components at a step, (N, D) each; exact values ``before`` it, (N, K D)."""


@dataclass
class GroupErrors:
    """Errors of a group of observation terms at one step.

    Attributes:
        columns: columns of each term, by name.
        offset: added error: bias and noise, (N, D).
        delay: in control steps, in [0, K], (N, D).
        before: exact values of the K steps before, the latest first, (N, K D).
    """

    columns: Mapping[str, slice]
    offset: Tensor
    delay: Tensor
    before: Tensor

    def __call__(self, exact: Tensor, columns: slice = slice(None)) -> Tensor:
        """Return the measured values, given the exact values of ``columns``."""
        size, delay = self.offset.shape[-1], self.delay[:, columns]
        if self.before.shape[-1] == size:  # at most one step late, as robots are: no gather in every step
            late = torch.lerp(exact, self.before[:, columns], delay)
        else:
            past = self.before.unflatten(-1, (-1, size))[..., columns]
            values = torch.cat([exact.unsqueeze(1), past], 1)
            whole = delay.floor().clamp_max(past.shape[1] - 1.0)
            first = whole.long().unsqueeze(1)
            newer, older = values.gather(1, first).squeeze(1), values.gather(1, first + 1).squeeze(1)
            late = torch.lerp(newer, older, delay - whole)
        return late + self.offset[:, columns]


class SensorErrors:
    """Sampler of the errors of observation terms; each robot has its own bias and delay for an episode.

    A bias starts with its standard deviation and, where it has a correlation time τ, evolves as a stationary
    Gauss-Markov process: b' = k b + √(1 - k²) σ n, with k = exp(-Δt / τ).

    Args:
        groups: the observation terms by key and name; groups without an error are skipped.
        sizes: components of every term, by key and name.
        num_envs: N.
        generator: source of randomness.

    Attributes:
        state: biases (N, D), delays (N, 1) and exact values of the K steps before (N, K D), by name; K is the largest
            delay so far.

    Example:
        >>> from torchrl_atr.envs.tasks import ObservationTerm
        >>> term = ObservationTerm(lambda c: c.state.euler, bias=0.1)
        >>> groups, sizes = {"proprio": {"euler": term}}, {"proprio": {"euler": 3}}
        >>> errors = SensorErrors(groups, sizes, 2, torch.Generator().manual_seed(0))
        >>> errors.start(torch.arange(2))["proprio"]["offset"].shape
        torch.Size([2, 3])
    """

    def __init__(
        self,
        groups: Mapping[NestedKey, Mapping[str, Any]],
        sizes: Mapping[NestedKey, Mapping[str, int]],
        num_envs: int,
        generator: torch.Generator,
    ) -> None:
        self.generator, self._sizes, self._num_envs = generator, sizes, num_envs
        self.state: dict[str, Tensor] = {}
        self._scales: dict[NestedKey, dict[str, Tensor]] = {}  # of each robot's episode, (N, D) each
        self._latest: dict[NestedKey, dict[str, Tensor]] = {}  # of episodes that start now, (D,) each
        self.set(groups)

    def set(self, groups: Mapping[NestedKey, Mapping[str, Any]]) -> None:
        """Set the errors of episodes that start from now on; robots keep theirs until then.

        Args:
            groups: as given before, with other errors.
        """
        for key, group in groups.items():
            if key not in self._scales:
                if not any(term.has_errors for term in group.values()):
                    continue
                self._allocate(key)
            counts = torch.tensor(list(self._sizes[key].values()))
            self._latest[key] = {
                name: torch.tensor([getattr(t, name) for t in group.values()]).float().repeat_interleave(counts)
                for name in _ERRORS
            }
            self._remember_longer(key, math.ceil(max(term.delay for term in group.values())))
        self._outdated = torch.ones(self._num_envs, dtype=torch.bool)

    def _allocate(self, key: NestedKey) -> None:
        """Allocate a group without errors."""
        total = sum(self._sizes[key].values())
        for name, size in (("bias", total), ("delay", 1), ("before", total)):
            self.state[_name(key, name)] = torch.zeros(self._num_envs, size, dtype=torch.float32)
        none = {name: torch.zeros(self._num_envs, total, dtype=torch.float32) for name in _ERRORS}
        self._scales[key] = none | _wandering(none)

    def _remember_longer(self, key: NestedKey, steps: int) -> None:
        """Keep the exact values of so many steps; those that nobody has seen are the oldest that are known."""
        size, known = sum(self._sizes[key].values()), self.state[_name(key, "before")]
        missing = steps - known.shape[-1] // size
        if missing > 0:
            self.state[_name(key, "before")] = torch.cat([known, known[:, -size:].repeat(1, missing)], -1)

    def _update(self, rows: Tensor) -> None:
        """Give ``rows`` the errors that were set last."""
        if self._outdated[rows].any():
            self._outdated[rows] = False
            for key, scale in self._scales.items():
                for name in _ERRORS:
                    scale[name][rows] = self._latest[key][name]
                scale |= _wandering(scale)

    def __bool__(self) -> bool:
        return bool(self._scales)

    def start(self, rows: Tensor) -> dict[NestedKey, Draw]:
        """Draw biases and delays for episodes of ``rows`` (n,) that start; return their errors, (n, D), by key.

        There is no previous value, so no delay; :meth:`remember` the exact values at the start of those rows.
        """
        self._update(rows)
        drawn = {}
        for key, scale in self._latest.items():
            bias = scale["bias"] * self._normal(len(rows), len(scale["bias"]))
            delay = torch.rand(len(rows), 1, generator=self.generator, dtype=torch.float32)
            self.state[_name(key, "bias")][rows] = bias
            self.state[_name(key, "delay")][rows] = delay
            none = torch.zeros_like(bias)
            drawn[key] = {"offset": bias + self._noise(scale, len(rows)), "delay": none, "before": none}
        return drawn

    def step(self) -> dict[NestedKey, Draw]:
        """Return the errors of all robots at the next step, (N, D), by key; biases evolve."""
        drawn = {}
        for key, scale in self._scales.items():
            bias, delay, before = (self.state[_name(key, name)] for name in ("bias", "delay", "before"))
            bias = self.state[_name(key, "bias")] = self._wander(bias, scale)
            drawn[key] = {
                "offset": bias + self._noise(scale, len(bias)),
                "delay": delay * scale["delay"],
                "before": before,
            }
        return drawn

    def remember(self, exact: Mapping[NestedKey, Tensor], rows: Tensor | slice = slice(None)) -> None:
        """Keep the exact values of ``rows``, (n, D) by key, for the next step's delays."""
        for key in self._scales:
            name, now = _name(key, "before"), exact[key]
            known, size = self.state[name], exact[key].shape[-1]
            if not isinstance(rows, slice):  # tensors that were returned before stay unchanged
                self.state[name] = known.index_copy(0, rows, now.repeat(1, known.shape[-1] // size))
            else:
                self.state[name] = now if known.shape[-1] == size else torch.cat([now, known[:, :-size]], -1)

    def _wander(self, bias: Tensor, scale: Mapping[str, Tensor]) -> Tensor:
        columns = scale["wandering"]
        if not len(columns):
            return bias
        keep, fresh = scale["keep"], scale["fresh"] * self._normal(len(bias), len(columns))
        return bias.index_copy(1, columns, keep * bias[:, columns] + fresh)

    def _noise(self, scale: Mapping[str, Tensor], n: int) -> Tensor:
        return scale["noise"] * self._normal(n, scale["noise"].shape[-1])

    def _normal(self, rows: int, columns: int) -> Tensor:
        return torch.randn(rows, columns, generator=self.generator, dtype=torch.float32)


def columns_of(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return the columns of each term of a group, by name.

    Example:
        >>> columns_of({"acceleration": 3, "orientation": 2})["orientation"]
        slice(3, 5, None)
    """
    columns, end = {}, 0
    for name, size in sizes.items():
        columns[name], end = slice(end, end + size), end + size
    return columns


def _wandering(scale: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the columns in which a bias wanders, its decay in a step, and the standard deviation of what is new."""
    wanders = torch.isfinite(scale["bias_time"]) & (scale["bias"] > 0)  # (N, D)
    columns = wanders.any(0).nonzero().squeeze(-1)
    keep = torch.where(wanders, torch.exp(-CONTROL_DT / scale["bias_time"]), 1.0)[:, columns]
    return {"wandering": columns, "keep": keep, "fresh": torch.sqrt(1.0 - keep.square()) * scale["bias"][:, columns]}


def _name(key: NestedKey, name: str) -> str:
    return f"{name} of {key if isinstance(key, str) else '/'.join(key)}"

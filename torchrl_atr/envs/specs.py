"""Specs of an env's outputs, and their nested form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded


def flag(n: int) -> Binary:
    """Return the spec of a bool for each of n robots, (n, 1)."""
    return Binary(n=1, shape=(n, 1), dtype=torch.bool)


def values(n: int, size: int) -> Unbounded:
    """Return the spec of ``size`` numbers for each of n robots, (n, size) float32."""
    return Unbounded((n, size), dtype=torch.float32)


def observation_spec(emitted: Mapping[NestedKey, Tensor], terms: Iterable[str]) -> Composite:
    """Return the spec of the outputs of reset and step besides reward and flags.

    Args:
        emitted: observations by key, (n, D) each.
        terms: names of the reward terms.

    Example:
        >>> sorted(observation_spec({"speeds": torch.zeros(3, 2)}, ["r0"]).keys(True, True), key=str)
        [('reward_terms', 'r0'), 'speeds']
    """
    n = len(next(iter(emitted.values())))
    spec = Composite(shape=(n,))
    for key, value in emitted.items():
        spec[key] = flag(n) if value.dtype == torch.bool else values(n, value.shape[-1])
    for name in terms:
        spec["reward_terms", name] = values(n, 1)
    return spec


def nested(values: Mapping[NestedKey, Any]) -> dict[str, Any]:
    """Return nested keys as nested dictionaries.

    Example:
        >>> nested({"a": 1, ("b", "c", "d"): 2})
        {'a': 1, 'b': {'c': {'d': 2}}}
    """
    root: dict[str, Any] = {}
    for key, value in values.items():
        *path, last = key if isinstance(key, tuple) else (key,)
        place = root
        for name in path:
            place = place.setdefault(name, {})
        place[last] = value
    return root

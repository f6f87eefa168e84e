"""Scores of a command curriculum: tracking rewards as shares of their values at zero error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from torchrl_atr._checks import check_kind, check_number
from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest_entry

TRACKING_KEYS: tuple[NestedKey, ...] = (
    ("reward_terms", "forward_command"),
    ("reward_terms", "steering_command"),
)


def check_scores(
    tracking_keys: Sequence[NestedKey], tracking_max: Sequence[float], thresholds: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Return maxima and thresholds as lists of floats, one per score.

    Raises:
        ValueError: if lengths differ, a maximum is not positive, or a value is of the wrong kind.

    Example:
        >>> check_scores(["speed"], (0.2,), torch.tensor([0.5]))
        ([0.2], [0.5])
    """
    for name, values in {"tracking_max": tracking_max, "thresholds": thresholds}.items():
        check_kind(name, values, (Sequence, Tensor), "a list of numbers, one per score")
        if isinstance(values, str | bytes) or (isinstance(values, Tensor) and values.ndim != 1):
            raise InputError(f"{name}={values!r}: give a list of numbers, one per score")
    if not len(tracking_keys) == len(tracking_max) == len(thresholds) > 0:
        raise ValueError(
            "tracking_keys, tracking_max and thresholds need one entry per score, got "
            f"{len(tracking_keys)}, {len(tracking_max)} and {len(thresholds)}"
        )
    maxima = [check_number("tracking_max", value, above=0) for value in _listed(tracking_max)]
    return maxima, [check_number("thresholds", value) for value in _listed(thresholds)]


def read_scores(keys: Sequence[NestedKey], next_tensordict: TensorDictBase, rows: int) -> Tensor:
    """Return the scores of a step, (rows, scores).

    Raises:
        KeyError: if one is missing.
        ValueError: if one is not one number per row.
    """
    scores = [next_tensordict.get(key, None) for key in keys]
    for key, score in zip(keys, scores):
        if score is None:
            raise KeyError(f"tracking key {key!r} is not in the step's output; {nearest_entry(key, next_tensordict)}")
        if score.numel() != rows:
            needed = (*next_tensordict.batch_size, 1)
            raise ValueError(f"tracking key {key!r} has shape {tuple(score.shape)}; a score needs {needed}")
    return torch.cat([score.reshape(-1, 1) for score in scores], -1)


def _listed(values: Sequence[float] | Tensor) -> Sequence[Any]:
    return values.tolist() if isinstance(values, Tensor) else values

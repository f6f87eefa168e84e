"""Which robots of a batch hold numbers that are none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor


def all_finite(values: Iterable[Tensor]) -> Tensor:
    """Whether there is no NaN or infinity in any of them, for the price of one sum: a bool of shape ().

    Example:
        >>> all_finite([torch.ones(2, 3), torch.tensor([[0.0], [float("nan")]])])
        tensor(False)
    """
    return torch.isfinite(torch.cat([value.flatten() for value in values]).sum())


def bad_rows(value: Tensor) -> list[int]:
    """Rows of an (N, features) entry that hold a NaN or an infinity; where there is none, mostly for one sum.

    Example:
        >>> bad_rows(torch.tensor([[1.0], [float("nan")]])), bad_rows(torch.full((2, 3), 3e38))  # whose sum overflows
        ([1], [])
    """
    return [] if value.sum().isfinite() else list(not_finite({"": value}))


def not_finite(values: Mapping[Any, Tensor]) -> dict[int, str]:
    """Rows that hold a NaN or an infinity, with the entry where it shows first.

    Args:
        values: by key, (N, features) each.

    Returns:
        Env ids and keys.

    Example:
        >>> not_finite({"a": torch.ones(2, 3), "b": torch.tensor([[0.0], [float("nan")]])})
        {1: 'b'}
    """
    bad: dict[int, str] = {}
    for key, value in values.items():
        for row in (~torch.isfinite(value)).any(-1).nonzero().flatten().tolist():
            bad.setdefault(row, "/".join(key) if isinstance(key, tuple) else key)
    return bad

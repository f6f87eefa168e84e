"""Which robots of a batch hold numbers that are none."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor


def not_finite(values: Mapping[Any, Tensor]) -> dict[int, str]:
    """Rows that hold a NaN or an infinity, with the entry where it shows first.

    Args:
        values: by key, (N, features) each.

    Returns:
        Env ids and keys; empty in the usual case, which costs one sum.

    Example:
        >>> not_finite({"a": torch.ones(2, 3), "b": torch.tensor([[0.0], [float("nan")]])})
        {1: 'b'}
    """
    if bool(torch.isfinite(torch.cat([value.flatten() for value in values.values()]).sum())):
        return {}
    bad: dict[int, str] = {}
    for key, value in values.items():
        for row in (~torch.isfinite(value)).any(-1).nonzero().flatten().tolist():
            bad.setdefault(row, "/".join(key) if isinstance(key, tuple) else key)
    return bad

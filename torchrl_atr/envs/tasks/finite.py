"""Detection of NaN and infinity in a batch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor

from torchrl_atr._errors import InputError


def all_finite(values: Iterable[Tensor]) -> Tensor:
    """Return whether all values are finite, at the cost of one sum: a bool of shape ().

    Example:
        >>> all_finite([torch.ones(2, 3), torch.tensor([[0.0], [float("nan")]])])
        tensor(False)
    """
    return torch.isfinite(torch.cat([value.flatten() for value in values]).sum())


def bad_rows(value: Tensor) -> list[int]:
    """Return the rows of an (N, features) entry that hold NaN or infinity; costs one sum if there are none.

    Example:
        >>> bad_rows(torch.tensor([[1.0], [float("nan")]])), bad_rows(torch.full((2, 3), 3e38))  # whose sum overflows
        ([1], [])
    """
    return [] if value.sum().isfinite() else list(not_finite({"": value}))


def as_float32(name: str, value: Tensor, shape: tuple[int, ...], what: str, remedy: str) -> Tensor:
    """Return an entry of any real or integer dtype as float32; without a copy if it is float32.

    Args:
        name: of the entry, for messages.
        value: the entry.
        shape: required shape.
        what: meaning of the features, for the message about the shape.
        remedy: advice about values that are not finite.

    Raises:
        InputError: for another shape, complex numbers, a NaN, an infinity, or a number beyond float32's 3.4e38.

    Example:
        >>> as_float32("action", torch.tensor([[1, 2]]), (1, 2), "one value per joint", "check the policy")
        tensor([[1., 2.]])
    """
    if tuple(value.shape) != tuple(shape):
        raise InputError(f"{name!r} has shape {tuple(value.shape)}; this env needs {tuple(shape)}: {what}")
    if value.is_complex():
        raise InputError(f"{name!r} holds complex numbers ({value.dtype}); give real ones")
    single = value.to(torch.float32)
    if bad := bad_rows(single):
        large = bool(torch.isfinite(value).all())
        why = f" as float32, of {torch.finfo(torch.float32).max:.2g} at most" if large else ""
        raise InputError(f"{name!r} is not finite for env ids {bad[:8]}{why}; {remedy}")
    return single


def not_finite(values: Mapping[Any, Tensor]) -> dict[int, str]:
    """Return the rows that hold NaN or infinity, with the first such entry of each.

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

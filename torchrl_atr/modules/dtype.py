"""Context manager for networks in the dtype of their data, whatever torch's default dtype."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def default_dtype(dtype: torch.dtype) -> Iterator[None]:
    """Create modules of this floating-point dtype inside the ``with`` block.

    Example:
        >>> with default_dtype(torch.float64):
        ...     weight = torch.nn.Linear(1, 1).weight
        >>> weight.dtype
        torch.float64
    """
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)

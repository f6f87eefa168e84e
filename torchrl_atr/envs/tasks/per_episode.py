"""Values that change between episodes: each row keeps the one that its episode began with."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, TypeVar

import torch
from torch import Tensor

T = TypeVar("T")


class PerEpisode(Generic[T]):
    """Value that can be set at any time and reaches each row when its next episode begins.

    Args:
        value: of all rows.
        rows: number of rows.

    Example:
        >>> sizes = PerEpisode("small", rows=3)
        >>> sizes.set("large")
        >>> sizes.begin(torch.tensor([1]))
        >>> [(value, rows.tolist()) for value, rows in sizes]
        [('small', [True, False, True]), ('large', [False, True, False])]
    """

    def __init__(self, value: T, rows: int) -> None:
        self._values = [value]
        self._index = torch.zeros(rows, dtype=torch.long)

    def set(self, value: T) -> None:
        """Set the value of episodes that begin from now on."""
        self._values.append(value)

    @property
    def latest(self) -> T:
        """Value that was set last."""
        return self._values[-1]

    def begin(self, rows: Tensor) -> None:
        """Begin episodes of ``rows``, (n,) integers, with the value that was set last."""
        if len(self._values) > 1:
            self._index = self._index.index_fill(0, rows, len(self._values) - 1)
            if unused := int(self._index.min()):
                self._values, self._index = self._values[unused:], self._index - unused

    def __iter__(self) -> Iterator[tuple[T, Tensor]]:
        """Iterate over the values, and the rows that have each, (N,) bool."""
        return ((value, self._index == i) for i, value in enumerate(self._values))

"""Let torch use as many threads as CPUs are free."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import torch

from torchrl_atr._cpus import NeighbourLoad, available_cpus, cpu_mask
from torchrl_atr._files import say

_INTERVAL = 2.0
"""Seconds between two measurements of the neighbours' load."""
_SHARE = 0.01
"""Share of the time that measurements may take, where there are so many processes that they take long."""
_SLACK = 0.4
"""CPUs that neighbours may use before torch leaves them one."""
_QUIET = 3
"""Measurements in a row with enough CPUs free before torch takes more threads again."""


class TorchThreads:
    """A context manager within which torch uses a given number of threads, or as many as CPUs are free.

    Every operation of torch ends when the last of its threads does. Where another process keeps one of them from its
    CPU, all others wait, and training is many times slower than with fewer threads. So the number is halved until it
    fits the free CPUs, and doubled when they are free again. A line says so the first time. torch's own number, and the
    ``num_threads`` of TorchRL's collectors, are fixed.

    Args:
        limit: the most threads; 0 for as many as torch has, within the CPUs that this process may use.
        adaptive: whether the number follows the free CPUs. Results depend on it to rounding.
        announce: called with the line; None for silence.

    Attributes:
        count: threads in use.

    Example:
        >>> with TorchThreads(1) as threads:
        ...     threads.update(), torch.get_num_threads()
        (None, 1)
    """

    def __init__(self, limit: int = 0, adaptive: bool = True, announce: Callable[[str], object] | None = say) -> None:
        self.limit = self.count = limit or min(torch.get_num_threads(), available_cpus())
        self.adaptive = adaptive and self.limit > 1
        self._announce = announce
        self._calm = 0

    def __enter__(self) -> TorchThreads:
        self._before = torch.get_num_threads()
        torch.set_num_threads(self.count)
        if self.adaptive:
            self._load = NeighbourLoad()
            self._next = time.monotonic() + _INTERVAL
        return self

    def __exit__(self, *exception: Any) -> None:
        torch.set_num_threads(self._before)

    def update(self) -> None:
        """Measure and adapt if it is time; to be called often, from the thread that uses torch."""
        started = time.monotonic()
        if not self.adaptive or started < self._next:
            return
        self.adapt(self._load.measure())
        now = time.monotonic()
        self._next = now + max(_INTERVAL, (now - started) / _SHARE)

    def adapt(self, others: float) -> None:
        """Choose the number of threads for a load.

        Args:
            others: CPUs that other processes keep busy.
        """
        cpus = len(cpu_mask())
        fitting, free = self.limit, min(available_cpus(), cpus - others + _SLACK)
        while fitting > 1 and fitting > free:
            fitting //= 2
        self._calm = self._calm + 1 if fitting > self.count else 0
        if fitting < self.count and self._announce is not None:
            self._announce(
                f"other processes keep {others:.1f} of {cpus} CPUs busy: until they are free torch works with "
                f"{fitting} of {self.limit} threads"
            )
            self._announce = None
        if fitting < self.count or self._calm >= _QUIET:
            self.count, self._calm = fitting, 0
            torch.set_num_threads(fitting)

"""Number of torch's threads: as many as CPUs are free, and one where more only cost time."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, TypeVar

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
_FEW_ROWS = 2048
"""Rows up to which torch's other threads cost more than they give: few of its operations are shared out at all."""
F = TypeVar("F", bound=Callable[..., Any])


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Run a block with one of torch's threads: others would spin on the CPUs that physics needs."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def one_torch_thread_if_small(method: F) -> F:
    """Decorate a method of an object with a ``batch_size``: if that is small, it runs with one of torch's threads.

    Sines, exponentials and the like wake the others however small a tensor is. Each time they have to be waited for,
    long where physics or another process has their CPU, and afterwards they spin on it for a while.

    Example:
        >>> class Batch:
        ...     batch_size = torch.Size([4])
        ...     @one_torch_thread_if_small
        ...     def threads(self):
        ...         return torch.get_num_threads()
        >>> Batch().threads()
        1
    """

    @functools.wraps(method)
    def call(owner: Any, *arguments: Any, **options: Any) -> Any:
        with one_torch_thread() if owner.batch_size.numel() <= _FEW_ROWS else nullcontext():
            return method(owner, *arguments, **options)

    return call  # type: ignore[return-value]


class TorchThreads:
    """Context manager within which torch uses a given number of threads, or as many as CPUs are free.

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

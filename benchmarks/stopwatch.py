"""Timer of phases, each without the phases inside it."""

from __future__ import annotations

import inspect
import time
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Any


class Stopwatch:
    """Timer of methods of single objects, while attached to them.

    Attributes:
        seconds: by phase; the time of a phase that runs inside another counts for the inner one alone.

    Example:
        >>> class Oven:
        ...     def heat(self):
        ...         return 200
        >>> watch, oven = Stopwatch(), Oven()
        >>> watch.attach(oven, "heat", "heating")
        >>> oven.heat(), watch.seconds["heating"] > 0
        (200, True)
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[Hashable, float] = defaultdict(float)
        self._running: list[Hashable] = []
        self._since = 0.0
        self._attached: list[tuple[Any, str, Any]] = []

    @contextmanager
    def phase(self, name: Hashable) -> Iterator[None]:
        """Count the time of a block for ``name`` instead of the phase around it."""
        self._count()
        self._running.append(name)
        try:
            yield
        finally:
            self._count()
            self._running.pop()

    def _count(self) -> None:
        now = time.perf_counter()
        if self._running:
            self.seconds[self._running[-1]] += now - self._since
        self._since = now

    def attach(self, owner: Any, name: str, phase: Hashable) -> None:
        """Time a method or a callable attribute of ``owner``; of a generator, the time spent inside it."""
        original = getattr(owner, name)
        self._attached.append((owner, name, vars(owner).get(name)))
        timed = self._timed_generator if inspect.isgeneratorfunction(original) else self._timed
        owner.__dict__[name] = timed(original, phase)

    def detach(self) -> None:
        """Restore all objects."""
        for owner, name, original in reversed(self._attached):
            if original is None:
                del owner.__dict__[name]
            else:
                owner.__dict__[name] = original
        self._attached.clear()

    def _timed(self, function: Callable[..., Any], phase: Hashable) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            with self.phase(phase):
                return function(*args, **kwargs)

        return timed

    def _timed_generator(self, function: Callable[..., Any], phase: Hashable) -> Callable[..., Iterator[Any]]:
        def timed(*args: Any, **kwargs: Any) -> Iterator[Any]:
            values = function(*args, **kwargs)
            while True:
                with self.phase(phase):
                    try:
                        value = next(values)
                    except StopIteration:
                        return
                yield value

        return timed

"""Handling of SIGINT and SIGTERM: a command ends at once and cleans up, a training run ends after its iteration."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_REPEAT = 1.0
"""Seconds in which further signals are the same request: timeout(1) sends two, a keyboard repeats."""


class Stopped(KeyboardInterrupt):
    """Exception in the main thread when a signal asks the process to stop; ``signal`` is its number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.signal = number


class Interrupt:
    """Handler that turns SIGINT and SIGTERM into :class:`Stopped`, or notes the first one and raises for the next.

    Python itself raises for SIGINT alone, wherever the program is; torch and TorchRL leave the signals of a run alone.
    A context manager for the main thread; in any other it leaves signals alone. One may stand inside another: the
    inner one counts.

    Args:
        notice: called for the first signal, which is then only noted; None to raise for it, too.

    Attributes:
        signal: the number of the first signal that came, or None.

    Example:
        >>> with Interrupt(lambda: print("stopping after this iteration")) as interrupt:
        ...     signal.raise_signal(signal.SIGTERM)
        stopping after this iteration
        >>> interrupt.signal == signal.SIGTERM
        True
        >>> try:
        ...     with Interrupt():
        ...         signal.raise_signal(signal.SIGINT)
        ... except Stopped as stop:
        ...     print(stop.signal)
        2
    """

    def __init__(self, notice: Callable[[], object] | None = None) -> None:
        self.notice = notice
        self.signal: int | None = None
        self._since = 0.0
        self._home: FrameType | None = None
        self._importer: FrameType | None = None
        self._previous: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupt:
        if threading.current_thread() is threading.main_thread():
            self._home = sys._getframe(1)
            self._previous = {number: signal.signal(number, self._handle) for number in SIGNALS}
        return self

    def __exit__(self, *exception: Any) -> None:
        self._home = None
        self._disarm()
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def mute(self) -> None:
        """Ignore further signals while a stopped process ends; the previous handlers are not restored."""
        self._disarm()
        for number in self._previous:
            signal.signal(number, signal.SIG_IGN)
        self._previous = {}

    def _handle(self, number: int, frame: FrameType | None) -> None:
        now, first = time.monotonic(), self.signal is None
        if not first and now - self._since < _REPEAT:
            return
        self._since = now
        if first:
            self.signal = number
        if not first or self.notice is None:
            self._disarm()
            self._stop(number, frame)
            return
        with suppress(RuntimeError):  # the signal came while the same stream was being written
            self.notice()

    def _stop(self, number: int, frame: FrameType | None) -> None:
        """Raise, and once more where an import ends: some modules take any error for a missing part and continue."""

        def stop(*event: Any) -> NoReturn:  # an error in a trace function ends the tracing
            raise Stopped(number)

        self._importer = self._find_importer(frame)
        if self._importer is not None and sys.gettrace() is None:  # else a debugger's
            self._importer.f_trace = stop
            sys.settrace(lambda *call: None)
            if frame is not None and frame.f_code.co_name == "cb" and _is_importlib(frame):
                return  # a lock is collected: Python would print the error, and go on
        stop()

    def _find_importer(self, frame: FrameType | None) -> FrameType | None:
        """Return the frame of this part of the program that is in the middle of an import, if one is."""
        found, inner = None, False
        while frame is not None and frame is not self._home:
            within = _is_importlib(frame)
            if inner and not within:
                found = frame
            frame, inner = frame.f_back, within
        return frame if inner and frame is not None else found

    def _disarm(self) -> None:
        """Forget what :meth:`_stop` has prepared."""
        if self._importer is not None and self._importer.f_trace is not None:
            self._importer.f_trace = None
            sys.settrace(None)
        self._importer = None


def _is_importlib(frame: FrameType) -> bool:
    return frame.f_code.co_filename.startswith("<frozen importlib")


@contextmanager
def signals_held(numbers: Iterable[signal.Signals] = SIGNALS) -> Iterator[None]:
    """Block signals in child processes that the block starts; here they arrive afterwards, or in another thread.

    A terminal sends Ctrl-C to children as well, which would end before this process has told them to. A child that is
    to be ended by one of the signals must not be started with that one held.

    Args:
        numbers: the signals.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_children() -> None:
    """Kill the children of :mod:`multiprocessing` that still run."""
    if "multiprocessing" in sys.modules:
        for process in sys.modules["multiprocessing"].active_children():
            process.kill()
            process.join()

"""A run that is asked to stop finishes its iteration first."""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any

from torchrl_atr._files import say

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """Notes the first SIGINT or SIGTERM instead of dying of it; a second one raises ``KeyboardInterrupt``.

    A context manager for the main thread; in any other it leaves signals alone.

    Attributes:
        signal: the number of the signal that came, or None.

    Example:
        >>> with Interrupt() as interrupt:
        ...     signal.raise_signal(signal.SIGTERM)
        stopping after this iteration; once more to stop at once
        >>> interrupt.signal == signal.SIGTERM
        True
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._previous: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupt:
        if threading.current_thread() is threading.main_thread():
            self._previous = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(self, *exception: Any) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.signal is not None:
            raise KeyboardInterrupt
        self.signal = number
        say("stopping after this iteration; once more to stop at once")

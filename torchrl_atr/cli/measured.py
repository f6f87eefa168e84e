"""Outcome of a protocol of ``evaluate``, handed on to be written and printed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from torchrl_atr.evaluation import EnduranceResult, TrackingResult


class Measured(NamedTuple):
    """Outcome of a protocol.

    Attributes:
        result: of the evaluation.
        metrics: of it.
        write: writes the report into a folder.
        lines: to print.
        finish: called when the report is in its place.
    """

    result: TrackingResult | EnduranceResult | dict[str, Any]
    metrics: dict[str, Any]
    write: Callable[[Path], Any]
    lines: list[str]
    finish: Callable[[], None] = lambda: None

"""Formatting of numbers and tables, and labels in texts."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from pathlib import Path


def number(value: float | None, width: int, decimals: int) -> str:
    """Return ``value`` in ``width`` characters, right-aligned: with ``decimals``, or an exponent where they do not fit.

    Args:
        value: None gives a dash.
        width: 8 or more hold any finite number.
        decimals: digits after the point where there is room.

    Example:
        >>> [number(value, 8, 3) for value in (1.5, -1234567.0, 1e300, float("nan"), None)]
        ['   1.500', '-1.2e+06', '1.0e+300', '     nan', '       -']
    """
    if value is None:
        return "-".rjust(width)
    text = f"{value:.{decimals}f}"
    if len(text) > width and math.isfinite(value):
        choices = (f"{value:.{digits}e}" for digits in (2, 1, 0))
        text = next((choice for choice in choices if len(choice) <= width), f"{value:.0e}")
    return text.rjust(width)


def with_unit(label: str, unit: str | None) -> str:
    """Return a quantity's label with its unit, if it has one.

    Example:
        >>> with_unit("speed", "m/s"), with_unit("contact", "1")
        ('speed, m/s', 'contact')
    """
    return label if unit in (None, "1") else f"{label}, {unit}"


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    r"""Return a Markdown table; bars in cells are escaped.

    Example:
        >>> print(markdown_table(["name", "m"], [["a|b", "1"]]))
        | name | m |
        | --- | --- |
        | a\|b | 1 |
    """
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def split_label(text: str, known: Container[str] = ()) -> tuple[str, str]:
    """Split ``LABEL=RUN`` at the first ``=``; a folder, or a ``known`` name, has no label, whatever it is called.

    Example:
        >>> split_label("ours=runs/a"), split_label("lr=0.1", known={"lr=0.1"})
        (('ours', 'runs/a'), ('', 'lr=0.1'))
    """
    if text in known or Path(text).is_dir() or "=" not in text:
        return "", text
    label, _, run = text.partition("=")
    return label, run

"""Formatting of numbers in columns of fixed width."""

from __future__ import annotations

import math
from collections.abc import Sequence


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

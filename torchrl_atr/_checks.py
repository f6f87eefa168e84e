"""Checks of argument values, one for each kind; errors name the argument and the remedy."""

from __future__ import annotations

import math
import numbers
from collections.abc import Collection
from typing import Any

import numpy as np

from torchrl_atr._errors import InputError

_LARGEST = 2**63 - 1


def check_whole(name: str, value: Any, low: int | None = 0, high: int | None = None, optional: bool = False) -> Any:
    """Return ``value`` as an ``int`` if it is a whole number of the range; a bool is not.

    Args:
        name: of the argument, for the message.
        value: what was given; integers of NumPy count.
        low: smallest value; None for no limit.
        high: largest value; None for the largest 64-bit integer.
        optional: whether None is a value too, which is returned as it is.

    Raises:
        InputError: for anything else.

    Example:
        >>> check_whole("num_envs", 4, low=1)
        4
        >>> check_whole("num_envs", 2.5, low=1)
        Traceback (most recent call last):
        torchrl_atr._errors.InputError: num_envs=2.5: choose a whole number, 1 or more
    """
    if optional and value is None:
        return None
    if isinstance(value, numbers.Integral) and not isinstance(value, bool):
        number = int(value)
        if (low is None or low <= number) and number <= (_LARGEST if high is None else high):
            return number
    span = "" if low is None else f", {low} or more" if high is None else f", {low} to {high}"
    raise InputError(f"{name}={value!r}: choose a whole number{span}{', or None' if optional else ''}")


def check_number(
    name: str, value: Any, low: float = -math.inf, high: float = math.inf, above: float | None = None
) -> float:
    """Return ``value`` as a ``float`` if it is a finite number of the range; a bool is not.

    Args:
        name: of the argument, for the message.
        value: what was given; integers and numbers of NumPy count.
        low: smallest value.
        high: largest value.
        above: exclusive lower bound; None for ``low`` alone.

    Raises:
        InputError: for anything else.

    Example:
        >>> check_number("retry", 1, 0, 1)
        1.0
        >>> check_number("retry", True, 0, 1)
        Traceback (most recent call last):
        torchrl_atr._errors.InputError: retry=True: choose a number in [0, 1]
    """
    if isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_):
        try:
            number = float(value)
        except OverflowError:  # an int beyond any float
            number = math.inf
        if math.isfinite(number) and low <= number <= high and (above is None or number > above):
            return number
    if above is not None:
        span = f"above {above:g}" + ("" if high == math.inf else f", up to {high:g}")
    elif high == math.inf:
        span = "that is finite" if low == -math.inf else f"{low:g} or more"
    else:
        span = f"in [{low:g}, {high:g}]"
    raise InputError(f"{name}={value!r}: choose a number {span}")


def check_pair(name: str, value: Any, wanted: str, low: float = 0.0, positive: bool = True) -> tuple[float, float]:
    """Return ``value`` as two floats if it is a sequence of two finite numbers of the range.

    Args:
        name: of the argument, for the message.
        value: what was given.
        wanted: what to give, in words, such as ``"two positive numbers (m/s, rad/s)"``.
        low: smallest value of both.
        positive: whether ``low`` itself is too small.

    Raises:
        InputError: for anything else.

    Example:
        >>> check_pair("margin", [2, 1.5], "two positive numbers")
        (2.0, 1.5)
    """
    above = low if positive else None
    try:
        first, second = value
        return check_number(name, first, low, above=above), check_number(name, second, low, above=above)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be {wanted}, got {value!r}") from None


def check_flag(name: str, value: Any) -> bool:
    """Return ``value`` if it is a bool; numbers are not.

    Raises:
        InputError: for anything else.

    Example:
        >>> check_flag("pushes", 2.0)
        Traceback (most recent call last):
        torchrl_atr._errors.InputError: pushes=2.0: choose True or False
    """
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name}={value!r}: choose True or False")
    return bool(value)


def check_choice(name: str, value: Any, choices: Collection[str]) -> str:
    """Return ``value`` if it is one of ``choices``.

    Raises:
        InputError: for anything else.

    Example:
        >>> check_choice("physics", "warp", ("batch", "dm_control"))
        Traceback (most recent call last):
        torchrl_atr._errors.InputError: unknown physics 'warp'; choose one of batch, dm_control
    """
    if not isinstance(value, str) or value not in choices:
        raise InputError(f"unknown {name} {value!r}; choose one of {', '.join(choices)}")
    return value


def check_kind(name: str, value: Any, kind: type | tuple[type, ...], wanted: str, optional: bool = False) -> Any:
    """Return ``value`` if it is an instance of ``kind``.

    Args:
        name: of the argument, for the message.
        value: what was given.
        kind: one or more classes.
        wanted: what to give, in words, such as ``"a name"``.
        optional: whether None is a value too.

    Raises:
        InputError: for anything else.

    Example:
        >>> check_kind("grid", 3, str, "a name")
        Traceback (most recent call last):
        torchrl_atr._errors.InputError: grid=3: give a name
    """
    if not (isinstance(value, kind) or (optional and value is None)):
        raise InputError(f"{name}={value!r}: give {wanted}{', or None' if optional else ''}")
    return value


def check_key(name: str, value: Any, optional: bool = False) -> Any:
    """Return ``value`` if it is the name of an entry, or a tuple of nested names.

    Raises:
        InputError: for anything else.

    Example:
        >>> check_key("out_key", ("next", "history"))
        ('next', 'history')
        >>> check_key("out_key", (1, 2))
        Traceback (most recent call last):
        torchrl_atr._errors.InputError: out_key=(1, 2): give a key: a text or a tuple of texts
    """
    parts = value if isinstance(value, tuple) and value else (value,)
    if not (all(isinstance(part, str) for part in parts) or (optional and value is None)):
        raise InputError(f"{name}={value!r}: give a key: a text or a tuple of texts{', or None' if optional else ''}")
    return value


def check_keys(name: str, value: Any, wanted: str = "a list of keys") -> Any:
    """Return ``value`` if it is a list or tuple of keys.

    Raises:
        InputError: for anything else.
    """
    for key in check_kind(name, value, (list, tuple), wanted):
        check_key(name, key)
    return value

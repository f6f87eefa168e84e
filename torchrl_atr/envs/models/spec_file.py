"""Specs in TOML files, and the checks of their values: shared by robots and transporters."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from torchrl_atr._errors import UserError
from torchrl_atr._registry import nearest

SUFFIX = ".toml"
SMALLEST, LARGEST = 1e-6, 1e6
"""Bounds of positive numbers in SI units, and of all: values beyond are errors, and break the solver."""
S = TypeVar("S")


class Spec(Protocol):
    """Interface of frozen dataclasses that check their fields."""

    def error(self, message: str) -> UserError:
        """Return an error that names the spec."""


def is_spec_file(spec: object) -> bool:
    """Return whether a robot or transporter is given by a file rather than by name."""
    return isinstance(spec, str | Path) and str(spec).endswith(SUFFIX)


def read_spec(
    path: str | Path,
    kind: Callable[..., S],
    noun: str,
    error: type[UserError],
    convert: Callable[[dict[str, Any], Path], None],
) -> S:
    """Read a dataclass from a TOML file whose keys are its fields.

    Args:
        path: of the file.
        kind: the dataclass.
        noun: name of its kind, for messages.
        error: raised with every message.
        convert: changes values that TOML cannot hold as the dataclass has them, in place; gets the file's folder.

    Raises:
        UserError: an ``error``, if the file is missing, malformed, lacks a key, has one too many, or holds an
            impossible value.
    """
    path = Path(path)
    if not path.is_file():
        raise error(f"there is no {noun} file {path}; check its path")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as failure:
        raise error(f"{path} is not valid TOML: {failure}") from failure
    try:
        check_names(values, kind, noun, error)
        convert(values, path.resolve().parent)
        return kind(**values)
    except error as failure:
        raise error(f"{path}: {failure}") from failure


def check_names(values: Mapping[str, Any], kind: Callable[..., Any], noun: str, error: type[UserError]) -> None:
    """Check that ``values`` has all keys that the dataclass ``kind`` needs, and no other; arguments as above."""
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]
    known = [field.name for field in fields]
    for key in values:
        if key not in known:
            raise error(f"unknown key {key!r}; {nearest(str(key), known)}")
    needed = [field.name for field in fields if field.default is dataclasses.MISSING]
    missing = [key for key in needed if key not in values]
    if missing:
        raise error(f"there is no {', '.join(missing)}; a {noun} needs {', '.join(needed)}")


def is_number(value: object) -> bool:
    """Return whether ``value`` is a number within the solver's bounds, and not a bool.

    Example:
        >>> [is_number(value) for value in (-3, 0.5, True, float("nan"), 1e300, 10**400)]
        [True, True, False, False, False, False]
    """
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def check_text(spec: Spec, *names: str) -> None:
    """Check that the fields ``names`` hold text."""
    for name in names:
        value = getattr(spec, name)
        if not isinstance(value, str) or not value:
            raise spec.error(f"{name}={value!r} is not a name; give a text")


def check_list(spec: Spec, name: str, kind: type, size: int, remedy: str) -> None:
    """Check a list of ``size`` strings or numbers and make it a tuple."""
    value = getattr(spec, name)
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise spec.error(f"{name}={value!r} is not a list; {remedy}")
    for entry in value:
        if not (isinstance(entry, str) if kind is str else is_number(entry)):
            raise spec.error(f"{name} holds {entry!r}; {remedy}")
    if len(value) != size:
        raise spec.error(f"{name} has {len(value)} entries instead of {size}; {remedy}")
    if kind is str and len(set(value)) < size:
        twice = next(entry for entry in value if value.count(entry) > 1)
        raise spec.error(f"{name} lists {twice!r} twice; {remedy}")
    object.__setattr__(spec, name, tuple(value))


def check_positive(spec: Spec, name: str, value: object, remedy: str = "must be a positive number") -> None:
    """Check a number of the field ``name``."""
    if not is_number(value) or value < SMALLEST:  # type: ignore[operator]
        raise spec.error(f"{name}={value!r} {remedy}")

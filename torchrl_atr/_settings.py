"""Typed settings: a field of a nested configuration is declared once, and all else is read from its declaration."""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import itertools
import numbers
import textwrap
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from torchrl_atr._errors import UserError
from torchrl_atr._registry import nearest


class ConfigError(UserError, ValueError):
    """Error of a configuration that has an unknown name or an invalid value."""


@dataclass(frozen=True)
class Setting:
    """Declaration of one field.

    Attributes:
        within: range of a number, both ends included.
        unit: of a number.
        question: number of the open question of the paper that it answers, such as ``"A9"``.
        addition: what it adds to the paper's method, in a few words; ``off`` turns that off in all presets.
        alias: short option of the command line, without dashes.
        presets: its values in presets, by name, or under ``off`` in all but ``default``; else the default's.
        path, default, kind, text: dotted name, default, type and docstring, once it is part of a configuration.
    """

    within: tuple[float, float] | None = None
    unit: str = ""
    question: str = ""
    addition: str = ""
    alias: str = ""
    presets: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    path: str = ""
    default: Any = None
    kind: Any = None
    text: str = ""

    def value_in(self, preset: str) -> Any:
        """Return its value in a preset."""
        otherwise = self.default if preset == "default" else self.presets.get("off", self.default)
        return self.presets.get(preset, otherwise)

    @property
    def range(self) -> str:
        """Allowed values in words: limits and unit of a number, else the choices."""
        if typing.get_origin(self.kind) is Literal:
            return ", ".join(typing.get_args(self.kind))
        limits = "" if self.within is None else "{:.10g} to {:.10g}".format(*self.within)
        return f"{limits} {self.unit}".strip()


def setting(default: Any, *, within: tuple[float, float] | None = None, **more: Any) -> Any:
    """Declare a field of a :class:`Settings` class; the text below the field says what it is, and why.

    Args:
        default: of the field; a mapping is copied.
        within: smallest and largest value of a number.
        **more: ``unit``, ``question``, ``addition`` and ``alias`` of :class:`Setting`; ``off``, its value in all
            presets but ``default``; any other name is a preset's, and its value in it.

    Example:
        >>> @dataclass(frozen=True)
        ... class Motor(Settings):
        ...     group = "motor"
        ...     gain: float = setting(40.0, within=(0, 100), unit="N m/rad", paper=38.0)
        >>> settings(Motor)["gain"].value_in("paper")
        38.0
        >>> Motor(gain=200)
        Traceback (most recent call last):
        torchrl_atr._settings.ConfigError: motor.gain=200.0 is out of range; choose a number in [0, 100] N m/rad
    """
    own = {name: more.pop(name) for name in ("unit", "question", "addition", "alias") if name in more}
    made: dict[str, Any] = {"default_factory": default.copy} if isinstance(default, dict) else {"default": default}
    return dataclasses.field(**made, metadata={"setting": Setting(within, presets=more, **own)})


@dataclass(frozen=True)
class Settings:
    """Group of settings; every value is checked by its declaration and stored as Python's own type.

    Raises:
        ConfigError: for a value of another kind or out of range; names it, and range and unit.
    """

    group: ClassVar[str] = ""

    def __post_init__(self) -> None:
        kinds = typing.get_type_hints(type(self))
        for field in dataclasses.fields(self):
            path, value = joined(self.group, field.name), getattr(self, field.name)
            if "setting" in field.metadata:
                value = _checked(path, value, kinds[field.name], field.metadata["setting"], _default(field))
            elif not isinstance(value, kinds[field.name]):
                raise ConfigError(f"{path}={value!r} is a group of settings; give {kinds[field.name].__name__}(...)")
            object.__setattr__(self, field.name, value)


def settings(kind: type[Settings]) -> dict[str, Setting]:
    """Return all settings of a configuration by dotted name, those of its groups included, in their order."""
    return _settings(kind)  # type: ignore[arg-type]  # a class, which mypy takes for what cannot be hashed


@functools.cache
def _settings(kind: Any, prefix: str = "") -> dict[str, Setting]:
    found: dict[str, Setting] = {}
    for name, hint, field in fields_of(kind):
        path = joined(prefix, name)
        if "setting" in field.metadata:
            own = field.metadata["setting"]
            text = _texts(kind).get(name, "")
            found[path] = dataclasses.replace(own, path=path, default=_default(field), kind=hint, text=text)
        else:
            found |= _settings(hint, path)
    return found


@functools.cache
def _texts(kind: type) -> dict[str, str]:
    """Return the texts below the fields of a class and its bases, by name; none where a source is not available."""
    inherited = {name: text for base in kind.__bases__ if base is not object for name, text in _texts(base).items()}
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    except (OSError, SyntaxError):
        return inherited
    found, body = inherited, tree.body[0].body  # type: ignore[attr-defined]
    for node, below in itertools.pairwise(body):
        if isinstance(node, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            found[ast.unparse(node.target)] = " ".join(str(below.value.value).split())
    return found


def fields_of(kind: type[Settings]) -> list[tuple[str, Any, Any]]:
    """Return name, type and field of each field of a group."""
    hints = typing.get_type_hints(kind)
    return [(field.name, hints[field.name], field) for field in dataclasses.fields(kind)]


def _default(field: Any) -> Any:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def joined(group: str, name: str) -> str:
    """Return a dotted name."""
    return f"{group}.{name}" if group else name


def _checked(path: str, value: Any, kind: Any, declared: Setting, default: Any) -> Any:
    """Return a value converted to its type.

    Raises:
        ConfigError: if it is of another kind or out of range.
    """
    try:
        return _converted(path, value, kind, declared)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{path}={value!r} does not fit; give {_wanted(kind, default)}") from None


def _converted(path: str, value: Any, kind: Any, declared: Setting) -> Any:
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return value
    if kind is bool and isinstance(value, bool | np.bool_):
        return bool(value)
    if kind in (int, float) and isinstance(value, numbers.Real) and not isinstance(value, bool):
        return _in_range(path, kind, value, declared)
    if kind is str and isinstance(value, str):
        return value
    if origin is Literal and isinstance(value, str):
        if value not in parts:
            raise ConfigError(f"{path}={value!r} is unknown; choose one of {', '.join(parts)}")
        return value
    if origin is tuple and isinstance(value, list | tuple):
        kinds = [parts[0]] * len(value) if parts[1:] == (...,) else list(parts)
        return tuple(_converted(path, part, each, declared) for part, each in zip(value, kinds, strict=True))
    if origin is dict and isinstance(value, Mapping):
        return {str(key): _converted(f"{path}.{key}", part, parts[1], declared) for key, part in value.items()}
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return value if isinstance(value, kind) else _part(path, kind, value, declared)
    raise TypeError


def _in_range(path: str, kind: type, value: Any, declared: Setting) -> float | int:
    if kind is int and (value != value or value in (float("inf"), float("-inf")) or value != int(value)):
        raise ValueError
    number = kind(value)
    if declared.within is not None and not declared.within[0] <= number <= declared.within[1]:  # nor is a NaN
        low, high = declared.within
        limits = f"[{low:.10g}, {high:.10g}] {declared.unit}".strip()
        raise ConfigError(f"{path}={number!r} is out of range; choose a number in {limits}")
    return number


def _part(path: str, kind: Any, value: Any, declared: Setting) -> Any:
    """Return a value of a mapping, itself a mapping, as a small dataclass."""
    if not isinstance(value, Mapping):
        raise TypeError
    hints = typing.get_type_hints(kind)
    for name in value:
        if name not in hints:
            raise ConfigError(f"unknown setting '{path}.{name}'; {nearest(name, hints)}")
    return kind(
        **{
            name: _checked(f"{path}.{name}", each, hints[name], declared, getattr(kind, name))
            for name, each in value.items()
        }
    )


def _wanted(kind: Any, default: Any) -> str:
    origin = typing.get_origin(kind)
    if kind is bool:
        return "true or false"
    if kind in (int, float):
        number = "a whole number" if kind is int else "a number"
        return f"{number} such as {default}" if isinstance(default, int | float) else number
    if origin is tuple:
        return (
            f"a list such as {','.join(map(str, default)) or 'my_module'}" if isinstance(default, tuple) else "a list"
        )
    if origin is dict or dataclasses.is_dataclass(kind):
        return "a table of names and values"
    return f"a text such as {default}"

"""Typed settings: a field of a nested configuration is declared once, and all else is read from its declaration."""

from __future__ import annotations

import ast
import dataclasses
import difflib
import functools
import inspect
import itertools
import json
import numbers
import textwrap
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from torchrl_atr._errors import UserError
from torchrl_atr._registry import nearest


class ConfigError(UserError, ValueError):
    """A configuration that names something unknown or holds an impossible value."""


@dataclass(frozen=True)
class Setting:
    """The declaration of one field.

    Attributes:
        within: range of a number, both ends included.
        unit: of a number.
        question: number of the open question of the paper that it answers, such as ``"A9"``.
        addition: what it adds to the paper's method, in a few words; ``off`` turns that off in all presets.
        alias: short option of the command line, without dashes.
        presets: its values in named presets; the default's in others.
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
        return self.presets.get(preset, self.presets.get("off", self.default) if preset != "default" else self.default)

    @property
    def range(self) -> str:
        """What it may be, in words: limits and unit of a number, else the choices."""
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
    """A group of settings; every value is checked by its declaration and kept as Python's own kind.

    Raises:
        ConfigError: for a value of another kind or out of range; names it, and range and unit.
    """

    group: ClassVar[str] = ""

    def __post_init__(self) -> None:
        kinds = typing.get_type_hints(type(self))
        for field in dataclasses.fields(self):
            path, value = _joined(self.group, field.name), getattr(self, field.name)
            if "setting" in field.metadata:
                value = _checked(path, value, kinds[field.name], field.metadata["setting"], _default(field))
            elif not isinstance(value, kinds[field.name]):
                raise ConfigError(f"{path}={value!r} is a group of settings; give {kinds[field.name].__name__}(...)")
            object.__setattr__(self, field.name, value)


@functools.cache
def settings(kind: type[Settings], prefix: str = "") -> dict[str, Setting]:
    """Return all settings of a configuration by dotted name, those of its groups included, in their order."""
    found: dict[str, Setting] = {}
    for name, hint, field in _fields(kind):
        path = _joined(prefix, name)
        if "setting" in field.metadata:
            own = field.metadata["setting"]
            text = _texts(kind).get(name, "")
            found[path] = dataclasses.replace(own, path=path, default=_default(field), kind=hint, text=text)
        else:
            found |= settings(hint, path)
    return found


def build(kind: type[Settings], values: Mapping[str, Any], root: type[Settings] | None = None, prefix: str = "") -> Any:
    """Make a configuration of nested mappings, as a file holds them.

    Args:
        kind: of the configuration, or of a group of it.
        values: by name.
        root: the configuration, for a group.
        prefix: name of the group.

    Raises:
        ConfigError: for an unknown field, whose nearest valid one is named with its group, or a wrong value.
    """
    groups = {name: hint for name, hint, field in _fields(kind) if "setting" not in field.metadata}
    made: dict[str, Any] = {}
    for name, value in values.items():
        path = _joined(prefix, name)
        if name in groups:
            if not isinstance(value, Mapping):
                raise ConfigError(f"{path}={value!r}: {path} is a group of settings; write {path}.NAME, or [{path}]")
            made[name] = build(groups[name], value, root or kind, path)
        elif name in {field.name for field in dataclasses.fields(kind)}:
            made[name] = value
        else:
            raise ConfigError(f"unknown setting {path!r}; {suggestion(root or kind, path)}")
    return kind(**made)


def suggestion(kind: type[Settings], path: str, write: Callable[[str], str] = str) -> str:
    """Say which setting was meant, and of which group it is.

    Args:
        kind: the configuration.
        path: dotted name of what there is not.
        write: how a dotted name is written where it was given.
    """
    known = settings(kind)
    group, _, name = path.rpartition(".")
    own = [each for each in known if each.rpartition(".")[0] == group]
    same = [each for each in known if each.rpartition(".")[2] == name]
    close = same or difflib.get_close_matches(path, own, 1, 0.75)
    if not close:
        by_name = {each.rpartition(".")[2]: each for each in known}
        close = [by_name[each] for each in difflib.get_close_matches(name, by_name, 1, 0.75)]
    if not close:
        return "`torchrl-atr list settings` shows all"
    of = f", of the group {close[0].rpartition('.')[0]}" if "." in close[0] else ""
    return f"did you mean {write(close[0])!r}{of}?"


def merged(*sources: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested mappings as one, the later winning setting by setting; dotted names are taken apart.

    Example:
        >>> merged({"ppo": {"gamma": 0.9, "epochs": 2}}, {"ppo.gamma": 0.5, "seed": 1})
        {'ppo': {'gamma': 0.5, 'epochs': 2}, 'seed': 1}
    """
    result: dict[str, Any] = {}
    for source in sources:
        for path, value in source.items():
            *groups, name = str(path).split(".")
            place = result
            for group in groups:
                if not isinstance(place.setdefault(group, {}), dict):
                    place[group] = {}
                place = place[group]
            if isinstance(value, Mapping):
                before = place.get(name)
                value = merged(before if isinstance(before, Mapping) else {}, value)
            place[name] = value
    return result


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested mappings as one of dotted names: what :func:`merged` takes apart.

    Example:
        >>> flat({"ppo": {"gamma": 0.9}, "seed": 1})
        {'ppo.gamma': 0.9, 'seed': 1}
    """
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {prefix + name: value}
    return found


def to_text(value: Any) -> str:
    """Return a plain value as the command line takes it.

    Example:
        >>> to_text([256, 128]), to_text(False), to_text(3e-4)
        ('256,128', 'false', '0.0003')
    """
    if isinstance(value, list | tuple):
        return ",".join(map(to_text, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def from_text(kind: type[Settings], path: str, text: str) -> Any:
    """Return what a word of the command line says, as the kind of the setting; itself if it is none of that kind.

    Args:
        kind: the configuration.
        path: dotted name of the setting, or of an entry of one that is a mapping.
        text: such as ``"256,128"``.
    """
    known = settings(kind)
    if path in known:
        return _read(known[path].kind, text)
    owner = max((each for each in known if path.startswith(f"{each}.")), key=len, default="")
    entry: Any = typing.get_args(known[owner].kind)[1] if owner else Any
    for name in path.removeprefix(f"{owner}.").split(".")[1:]:
        entry = typing.get_type_hints(entry).get(name, Any) if dataclasses.is_dataclass(entry) else Any
    return _read(entry, text)


def _read(kind: Any, text: str) -> Any:
    try:
        if kind is bool:
            return {"true": True, "false": False}[text.lower()]
        if kind in (int, float):
            return float(text)
        if typing.get_origin(kind) is tuple:
            return [_read(typing.get_args(kind)[0], part) for part in text.split(",") if part]
        if kind is Any:
            return json.loads(text)
    except (KeyError, ValueError):
        pass
    return text


@functools.cache
def _texts(kind: type) -> dict[str, str]:
    """Return the texts below the fields of a class, by name; none where its source is not at hand."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    except (OSError, SyntaxError):
        return {}
    found, body = {}, tree.body[0].body  # type: ignore[attr-defined]
    for node, below in itertools.pairwise(body):
        if isinstance(node, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            found[ast.unparse(node.target)] = " ".join(str(below.value.value).split())
    return found


def _fields(kind: type[Settings]) -> Iterable[tuple[str, Any, Any]]:
    hints = typing.get_type_hints(kind)
    return [(field.name, hints[field.name], field) for field in dataclasses.fields(kind)]


def _default(field: Any) -> Any:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def _joined(group: str, name: str) -> str:
    return f"{group}.{name}" if group else name


def _checked(path: str, value: Any, kind: Any, declared: Setting, default: Any) -> Any:
    """Return a value as its kind.

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
    if dataclasses.is_dataclass(kind):
        return value if isinstance(value, kind) else _part(path, kind, value, declared)
    raise TypeError


def _in_range(path: str, kind: type, value: Any, declared: Setting) -> float | int:
    if kind is int and (value != value or value in (float("inf"), float("-inf")) or value != int(value)):
        raise ValueError
    number = kind(value)
    if declared.within is not None and not declared.within[0] <= number <= declared.within[1]:  # nor is a NaN
        limits = "[{:.10g}, {:.10g}] {}".format(*declared.within, declared.unit).strip()
        raise ConfigError(f"{path}={number!r} is out of range; choose a number in {limits}")
    return number


def _part(path: str, kind: Any, value: Any, declared: Setting) -> Any:
    """Return a value of a mapping that is a small dataclass of its own."""
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

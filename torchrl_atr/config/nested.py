"""Nested settings as mappings and texts: merging, flattening, parsing, and construction of a configuration."""

from __future__ import annotations

import dataclasses
import difflib
import json
import typing
from collections.abc import Callable, Mapping
from typing import Any

from torchrl_atr._settings import ConfigError, Settings, fields_of, joined, settings


def build(kind: type[Settings], values: Mapping[str, Any], root: type[Settings] | None = None, prefix: str = "") -> Any:
    """Build a configuration from nested mappings, as a file holds them.

    Args:
        kind: of the configuration, or of a group of it.
        values: by name.
        root: the configuration, for a group.
        prefix: name of the group.

    Raises:
        ConfigError: for an unknown field, whose nearest valid one is named with its group, or a wrong value.
    """
    groups = {name: hint for name, hint, field in fields_of(kind) if "setting" not in field.metadata}
    made: dict[str, Any] = {}
    for name, value in values.items():
        path = joined(prefix, name)
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
    """Return a hint at the setting that was meant, and its group.

    Args:
        kind: the configuration.
        path: unknown dotted name.
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
    """Return nested mappings as one, the later winning setting by setting; dotted names become nested.

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
    """Return nested mappings as one of dotted names, the inverse of :func:`merged`.

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
    """Return a word of the command line converted to the type of the setting; unchanged if it does not fit.

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

"""Configurations from files, mappings and ``key=value`` strings."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from torchrl_atr._registry import nearest
from torchrl_atr.envs.models.files import COPIES
from torchrl_atr.envs.models.spec_file import is_spec_file
from torchrl_atr.training.config import TrainConfig
from torchrl_atr.training.config_checks import ConfigError
from torchrl_atr.training.recipes import recipe_of


def make_config(values: dict[str, Any] | None = None, overrides: list[str] | None = None) -> TrainConfig:
    """A configuration from a mapping and ``key=value`` strings, the latter winning.

    Args:
        values: field values.
        overrides: strings such as ``"gamma=0.99"``.

    Raises:
        ConfigError: for an unknown field or a value of the wrong kind or out of range.

    Example:
        >>> make_config({"num_envs": 8}, ["gamma=0.9"]).gamma
        0.9
    """
    merged = dict(values or {})
    for text in overrides or []:
        key, separator, value = text.partition("=")
        if not separator:
            raise ConfigError(f"--set {text!r}: write it as key=value, such as --set gamma=0.99")
        merged[key.strip()] = value.strip()
    recipe = recipe_of(str(merged.get("profile", "default")), str(merged.get("task", "riding")))
    merged = {**recipe, **merged}
    defaults = {field.name: field.default for field in dataclasses.fields(TrainConfig)}
    for name, value in merged.items():
        if name not in defaults:
            raise ConfigError(_unknown(name, value, defaults))
    return TrainConfig(**{name: _convert(name, value, defaults[name]) for name, value in merged.items()})


def _unknown(name: str, value: Any, known: Iterable[str]) -> str:
    if isinstance(value, dict):
        return f"unknown section [{name}]; write its settings at the top of the file, without sections"
    return f"unknown setting {name!r}; {nearest(name, known, '`torchrl-atr list settings` shows all')}"


def read_config(path: str | Path) -> dict[str, Any]:
    """Field values from a ``.toml`` or ``.json`` file.

    A robot's file is looked up in its folder, as in a run's ``config.json``, else in the working directory.

    Raises:
        ConfigError: if it is missing, of another kind, or malformed.
    """
    path = Path(path)
    parse = {".toml": tomllib.loads, ".json": json.loads}.get(path.suffix)
    if parse is None:
        raise ConfigError(f"{path}: use a .toml or .json file")
    if not path.is_file():
        raise ConfigError(f"there is no configuration file {path}; check its path")
    try:
        values = parse(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not valid {path.suffix[1:].upper()}: {error}; correct it there") from error
    if not isinstance(values, dict):
        raise ConfigError(f'{path} holds a {type(values).__name__}; write settings in it, such as {{"gamma": 0.99}}')
    files = {name: path.parent / values[name] for name in COPIES if is_spec_file(values.get(name))}
    return values | {name: str(file) for name, file in files.items() if file.is_file()}


_KINDS = {
    int: "a whole number such as {}",
    float: "a number such as {}",
    bool: "true or false",
    str: "a text such as {}",
    tuple: "a list such as {}",
}


def _convert(name: str, value: Any, default: Any) -> Any:
    """``value`` as the type of the field's default."""
    kind = type(default)
    try:
        if isinstance(value, bool) and kind is not bool:
            raise TypeError
        if kind is tuple:
            parts = [part for part in value.split(",") if part] if isinstance(value, str) else value
            return tuple(_convert(name, part, default[0] if default else "") for part in parts)
        if kind is bool:
            return {"true": True, "false": False}[str(value).lower()]
        if kind is int:
            number = float(value)
            if number != int(number):
                raise ValueError
            return int(number)
        if kind is float:
            return float(value)
        if not isinstance(value, str):
            raise TypeError
        return value
    except (KeyError, TypeError, ValueError, OverflowError):
        example = ",".join(map(str, default)) or "my_module" if kind is tuple else default
        raise ConfigError(f"{name}={value!r} does not fit; give {_KINDS[kind].format(example)}") from None

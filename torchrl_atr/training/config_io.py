"""Configurations from files, mappings and ``key=value`` strings."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from pathlib import Path
from typing import Any

from torchrl_atr.training.config import ConfigError, TrainConfig
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
    recipe = recipe_of(str(merged.get("profile", "default")))
    merged = {**recipe, **merged}
    for text in overrides or []:
        key, separator, value = text.partition("=")
        if not separator:
            raise ConfigError(f"--set {text!r}: write it as key=value")
        merged[key.strip()] = value.strip()
    fields = {field.name: field for field in dataclasses.fields(TrainConfig)}
    for name in merged:
        if name not in fields:
            raise ConfigError(f"unknown setting {name!r}; known: {', '.join(fields)}")
    return TrainConfig(**{name: _convert(name, value, fields[name].default) for name, value in merged.items()})


def read_config(path: Path) -> dict[str, Any]:
    """Field values from a ``.toml`` or ``.json`` file.

    Raises:
        ConfigError: if it is missing, of another kind, or malformed.
    """
    if not path.is_file():
        raise ConfigError(f"there is no configuration file {path}")
    try:
        if path.suffix == ".toml":
            return tomllib.loads(path.read_text())
        if path.suffix == ".json":
            return json.loads(path.read_text())
    except (tomllib.TOMLDecodeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not valid {path.suffix[1:].upper()}: {error}") from error
    raise ConfigError(f"{path}: use a .toml or .json file")


def _convert(name: str, value: Any, default: Any) -> Any:
    """``value`` as the type of the field's default."""
    kind = type(default)
    try:
        if kind is tuple:
            parts = [part for part in value.split(",") if part] if isinstance(value, str) else value
            return tuple(type(default[0])(part) if default else str(part) for part in parts)
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
        raise ConfigError(f"{name}={value!r} is not a valid {kind.__name__}") from None

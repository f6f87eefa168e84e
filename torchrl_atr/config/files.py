"""Files of nested settings: TOML or JSON to read, TOML with a comment for each setting to write."""

from __future__ import annotations

import json
import re
import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from torchrl_atr._settings import ConfigError, Settings, settings


def read_values(path: Path) -> dict[str, Any]:
    """Return the content of a ``.toml`` or ``.json`` file.

    Raises:
        ConfigError: if it is missing, of another kind, or malformed.
    """
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
        raise ConfigError(f'{path} holds a {type(values).__name__}; write settings in it, such as {{"seed": 1}}')
    return values


def to_toml(kind: type[Settings], values: Mapping[str, Any], prefix: str = "") -> str:
    """Return nested settings as TOML, each below a comment that describes it.

    Args:
        kind: of the configuration.
        values: plain values by name.
        prefix: of the names, with a dot at its end.

    Example:
        >>> from torchrl_atr.envs.tasks.events import Pushes
        >>> print(to_toml(Pushes, {"interval": 3.0}))
        # Time between two pushes; 0 for none. Four of five falls come within a second of a push. [0 to 1000000 s]
        interval = 3.0
        <BLANKLINE>
    """
    return "\n".join(_lines(kind, values, prefix)) + "\n"


def _lines(kind: type[Settings], values: Mapping[str, Any], prefix: str) -> Iterator[str]:
    for name, value in values.items():
        if not isinstance(value, Mapping):
            yield from _comment(kind, prefix + name)
            yield f"{_key(name)} = {json.dumps(value, ensure_ascii=False)}"
    for name, value in values.items():
        if isinstance(value, Mapping):
            path = ".".join(map(_key, (prefix + name).split(".")))
            yield from ("", *_comment(kind, prefix + name), f"[{path}]", *_lines(kind, value, f"{prefix}{name}."))


def _comment(kind: type[Settings], path: str) -> list[str]:
    declared = settings(kind).get(path)
    if declared is None:
        return []
    text = declared.text + (f" [{declared.range}]" if declared.range else "")
    return textwrap.wrap(text, 120, initial_indent="# ", subsequent_indent="# ")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)

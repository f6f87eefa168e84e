"""Files of commands over time, CSV or TOML, which are checked before anything is simulated."""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import torch

from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest
from torchrl_atr.evaluation.video import Command
from torchrl_atr.modules import CommandRange

COLUMNS = ("time", "speed", "yaw_rate")
"""Columns of a file: s since the start of the ride, m/s, rad/s."""
LAST_SECONDS = 5.0
"""Duration of the last command, s."""
_FILES = resources.files("torchrl_atr.evaluation") / "command_files"


def command_file_names() -> list[str]:
    """Return the names of the command files in the package.

    Example:
        >>> command_file_names()
        ['figure6']
    """
    return sorted(Path(file.name).stem for file in _FILES.iterdir() if file.name.endswith(".csv"))


def read_commands(source: str | Path) -> tuple[Command, ...]:
    """Return the commands of a file: second at which each begins, c_v (m/s) and c_ω (rad/s).

    A ``.csv`` file has the columns ``time``, ``speed`` and ``yaw_rate`` in any order, and lines that begin with ``#``
    are comments; a ``.toml`` file has a table ``[[command]]`` with these three entries for each command. A command
    lasts until the next one begins.

    Args:
        source: a file, or one of :func:`command_file_names`.

    Raises:
        InputError: for a file that is missing, empty or not of these two kinds, a wrong or missing column, an entry
            that is missing or no finite number, a first time other than 0, and times that do not increase; names the
            place.

    Example:
        >>> read_commands("figure6")[1]
        (2.0, 1.0, 0.0)
    """
    path = Path(source)
    if path.suffix not in (".csv", ".toml"):
        if str(source) in command_file_names():
            return read_commands(Path(str(_FILES / f"{source}.csv")))
        known = nearest(str(source), command_file_names())
        raise InputError(f"{str(source)!r} is no file of commands; give a .csv or .toml file, or a name ({known})")
    if not path.is_file():
        raise InputError(f"there is no file of commands {path}; check its path")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text ({error}); save it as such") from None
    rows = list((_csv_rows if path.suffix == ".csv" else _toml_rows)(text, path))
    commands: list[Command] = []
    for place, values in rows:
        time, speed, yaw_rate = (_number(values.get(name), name, place) for name in COLUMNS)
        if not commands and time != 0.0:
            raise InputError(f"{place}: the first command begins at {time:g} s, and there is none before; begin at 0")
        if commands and time <= commands[-1][0]:
            raise InputError(f"{place}: time {time:g} does not come after {commands[-1][0]:g}; times must increase")
        commands.append((time, speed, yaw_rate))
    if not commands:
        raise InputError(f"{path} holds no command; give one row of {', '.join(COLUMNS)} for each")
    return tuple(commands)


def _csv_rows(text: str, path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.lstrip()[:1] not in ("", "#")]
    cells = [next(csv.reader([line], skipinitialspace=True)) for _, line in lines]
    if not cells:
        return
    head = [name.strip() for name in cells[0]]
    _check_names(head, f"{path}, line {lines[0][0]}", "column")
    for (number, _), row in zip(lines[1:], cells[1:]):
        place = f"{path}, line {number}"
        if len(row) > len(head):
            raise InputError(f"{place}: {len(row)} entries for {len(head)} columns; give one for each")
        yield place, dict(zip(head, row))


def _toml_rows(text: str, path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path} is not valid TOML: {error}; correct it there") from None
    tables = values.pop("command", [])
    if values or not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InputError(f"{path}: write a table [[command]] with {', '.join(COLUMNS)} for each command, nothing else")
    for number, table in enumerate(tables, 1):
        place = f"{path}, command {number}"
        _check_names(table, place, "entry")
        yield place, table


def _check_names(names: Any, place: str, what: str) -> None:
    for name in names:
        if name not in COLUMNS:
            raise InputError(f"{place}: unknown {what} {name!r}; the {what} names are {', '.join(COLUMNS)}")
    if missing := [name for name in COLUMNS if name not in names]:
        raise InputError(f"{place}: no {what} {', '.join(missing)}; give {', '.join(COLUMNS)}")
    if len(names) > len(COLUMNS):
        raise InputError(f"{place}: a {what} stands there twice; give {', '.join(COLUMNS)} once each")


def _number(value: Any, name: str, place: str) -> float:
    if value is None or (isinstance(value, str) and not value.strip()):
        raise InputError(f"{place}: {name} is missing; fill the gap")
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{place}: {name}={value!r} is no finite number")
    return number


def check_commands(commands: Sequence[Command], limits: CommandRange) -> None:
    """Refuse commands beyond a policy's range.

    Args:
        commands: of :func:`read_commands`.
        limits: the range.

    Raises:
        InputError: for the first such command; names it and the range.

    Example:
        >>> check_commands([(0.0, 3.0, 0.0)], CommandRange(max_speed=2.0, max_yaw_rate=1.0))
        Traceback (most recent call last):
        torchrl_atr._errors.InputError: the command at 0 s, 3 m/s and 0 rad/s, is beyond the policy's range: speed in \
[-2, 2] m/s, yaw rate in [-1, 1] rad/s; choose a smaller one
    """
    asked = torch.tensor([command[1:] for command in commands])
    beyond = ~torch.isclose(limits(asked), asked, rtol=0.0, atol=1e-6).all(-1)
    if not beyond.any():
        return
    time, speed, yaw_rate = commands[int(beyond.nonzero()[0])]
    low = 0.0 if limits.forward_only else -limits.max_speed
    lateral = limits.max_lateral_acceleration
    product = "" if lateral is None else f", |speed times yaw rate| up to {lateral:g} m/s²"
    raise InputError(
        f"the command at {time:g} s, {speed:g} m/s and {yaw_rate:g} rad/s, is beyond the policy's range: speed in "
        f"[{low:g}, {limits.max_speed:g}] m/s, yaw rate in [{-limits.max_yaw_rate:g}, {limits.max_yaw_rate:g}] rad/s"
        f"{product}; choose a smaller one"
    )


def duration(commands: Sequence[Command]) -> float:
    """Return the length of a ride through all commands, the last of which lasts :data:`LAST_SECONDS`, s."""
    return commands[-1][0] + LAST_SECONDS

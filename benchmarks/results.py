"""Shared parts of the measurements: their files, their provenance, checks of settings, and exit codes."""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from torchrl_atr import cli
from torchrl_atr._errors import UserError
from torchrl_atr._files import atomic, prepare_output, say, write_json
from torchrl_atr._interrupt import Interrupt, Stopped
from torchrl_atr.config.nested import flat
from torchrl_atr.runs.checkpoint import NAME as CHECKPOINT
from torchrl_atr.runs.files import CONFIG
from torchrl_atr.runs.provenance import cores
from torchrl_atr.training import (
    ConfigError,
    TrainConfig,
    Trainer,
    load_checkpoint,
    make_config,
    parse_settings,
    read_config,
)


def write(folder: Path, name: str, report: dict[str, Any], readme: str) -> None:
    """Write ``<name>.json`` and ``README.md``, each atomically."""
    write_json(folder / f"{name}.json", report)
    with atomic(folder / "README.md") as file:
        file.write_text(readme, encoding="utf-8")


def origin(report: dict[str, Any]) -> str:
    """Return a sentence with the command, the time and the machine of the figures.

    Args:
        report: with ``command``, ``wall_seconds`` and ``hardware``.

    Example:
        >>> origin({"command": "count", "wall_seconds": 3.0, "hardware": {"cpus": 1, "processor": "Z80"}})
        '`count`: 3 s on 1 core (Z80).'
    """
    return f"`{report['command']}`: {report['wall_seconds']:.0f} s on {cores(report['hardware'])}."


def call(*words: Any) -> None:
    """Run a command of ``torchrl-atr``, after a line that says which.

    Raises:
        Stopped: if a signal stopped it.
        UserError: if it failed; its message is above.
    """
    asked = [str(word) for word in words]
    say(f"torchrl-atr {shlex.join(asked)}")
    code = cli.main(asked)
    if code > 128:
        raise Stopped(code - 128)
    if code:
        raise UserError(
            f"`torchrl-atr {shlex.join(asked)}` failed; see its message above. The same command goes on here"
        )


def parse_overrides(texts: list[str]) -> dict[str, Any]:
    """Return the settings of ``--set KEY=VALUE``.

    Raises:
        ConfigError: for one without a value.

    Example:
        >>> parse_overrides(["ppo.gamma=0.9"])
        {'ppo.gamma': 0.9}
    """
    for text in texts:
        if "=" not in text:
            raise ConfigError(f"--set {text!r}: write it as KEY=VALUE, such as --set ppo.gamma=0.99")
    return parse_settings(dict(text.split("=", 1) for text in texts))


def train(config: TrainConfig, folder: Path) -> None:
    """Train to the end of the run, from the checkpoint if there is one.

    Raises:
        KeyboardInterrupt: if training was stopped.
    """
    trainer = Trainer(config, folder, load_checkpoint(folder) if (folder / CHECKPOINT).is_file() else None)
    if not trainer.finished:
        trainer.train()
    if not trainer.finished:
        raise KeyboardInterrupt


def refuse_other_settings(config: TrainConfig, folder: Path, free: Sequence[str] = ()) -> None:
    """Refuse to mix runs of different settings in one table.

    Args:
        config: that is asked for.
        folder: of a run, or of nothing yet.
        free: settings that may differ, or groups of them, as what a run computes with.

    Raises:
        ConfigError: if ``folder`` holds a run that was trained differently.
    """
    path = folder / CONFIG
    if not path.is_file():
        return
    asked, found = flat(config.to_dict()), flat(make_config(read_config(path)).to_dict())
    other = ", ".join(
        f"{key}={found.get(key)} instead of {value}"
        for key, value in asked.items()
        if found.get(key) != value and key not in free and key.partition(".")[0] not in free
    )
    if other:
        raise ConfigError(f"{folder} was trained with {other}; give another folder, or remove that one")


def exit_code(name: str, measure: Callable[[], None]) -> int:
    """Run a measurement; return 0, 130 or 143 if it was stopped, or 2 after a message about wrong input.

    Args:
        name: of the benchmark, for messages.
        measure: continues where it was stopped when called again.
    """
    with Interrupt():
        prepare_output()
        try:
            measure()
        except KeyboardInterrupt as stop:
            sys.stderr.write("stopped; the same command continues\n")
            return 128 + getattr(stop, "signal", signal.SIGINT)
        except UserError as error:
            sys.stderr.write(f"{name}: {error}\n")
            return 2
    return 0

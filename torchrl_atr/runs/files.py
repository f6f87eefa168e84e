"""Names of a run's files, and functions that copy, clear and locate them."""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from torchrl_atr._files import atomic, naming
from torchrl_atr.config import TrainConfig
from torchrl_atr.envs.models.files import COPIES
from torchrl_atr.envs.models.spec_file import is_spec_file
from torchrl_atr.modules import COMMAND_RANGE_FILE
from torchrl_atr.runs.checkpoint import BEST, NAME, PREVIOUS

MODEL = "model"
"""Folder of a run that holds its robot's and its transporter's files."""
CONFIG = "config.toml"
"""File of a run that holds its settings, to be edited and started from."""
ORIGIN = "run.json"
"""File of a run that holds its provenance."""
LOG = "progress.csv"
"""File of a run that holds the metrics of every iteration."""
REPORTS = ("metrics.json", "tracking.npz", "scorecard.json")
"""Files of what was measured of a run, in it or in a folder for each protocol."""
DUMPS = "diverged"
"""Folder of a run for the dumps of simulations that failed."""


def keep_files(config: TrainConfig, run: Path, fresh: bool) -> TrainConfig:
    """Copy the files that a configuration names into the run, unless they are there; return it with the copies.

    A ``fresh`` run keeps nothing of an earlier one's.

    Raises:
        RobotError: if a robot reads a file that cannot be copied.
        OSError: if a file cannot be read or written.
    """
    folder = run.resolve() / MODEL
    given = {name: Path(getattr(config.task, name)) for name in COPIES if is_spec_file(getattr(config.task, name))}
    if not fresh and all(path.is_relative_to(folder) for path in given.values()):
        return config
    staged = folder.with_name(f".{MODEL}.{os.getpid()}.part")
    copies: dict[str, Any] = {}
    with naming(folder):
        try:
            for name, path in given.items():  # before the old folder is removed: they may be in it
                copies[name] = str(folder / COPIES[name](path, staged / name).relative_to(staged))
            if folder.exists():
                shutil.rmtree(folder)
            if given:
                os.replace(staged, folder)
        finally:
            shutil.rmtree(staged, ignore_errors=True)
    return dataclasses.replace(config, task=dataclasses.replace(config.task, **copies)) if copies else config


def clear(run: Path) -> None:
    """Remove what an earlier run wrote to the folder, and what was measured of it: two runs must not mix."""
    for name in (NAME, PREVIOUS, BEST, LOG, "mlflow.db", COMMAND_RANGE_FILE, *REPORTS):
        (run / name).unlink(missing_ok=True)
    measured = [file.parent.name for file in run.glob(f"*/{REPORTS[0]}")]
    for name in ("tensorboard", "wandb", DUMPS, *measured):
        shutil.rmtree(run / name, ignore_errors=True)


def copy_log(run: Path, folder: Path, rows: int, columns: Collection[str] | None = None) -> None:
    """Copy every so many rows of a run's log, ``rows`` at most, into another folder; all columns unless named.

    Raises:
        OSError: if there is no log, or it cannot be written.
    """
    log = pd.read_csv(run / LOG, usecols=columns and (lambda name: name in columns))
    with atomic(folder / LOG) as temporary:
        log.iloc[:: max(1, -(-len(log) // rows))].to_csv(temporary, index=False, float_format="%.6g")


def stored_settings(config: TrainConfig, run: Path) -> dict[str, Any]:
    """Return a configuration as plain JSON values that name the run's own files relative to its folder."""
    settings, folder = config.to_dict(), run.resolve()
    task = settings["task"]
    for name in COPIES:
        if is_spec_file(task[name]) and Path(task[name]).is_relative_to(folder):
            task[name] = Path(task[name]).relative_to(folder).as_posix()
    return settings


def located_settings(settings: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Undo :func:`stored_settings`, wherever the run's folder is now; absolute paths and names stay as they are.

    Example:
        >>> located_settings({"task": {"robot": "model/robot/mine.toml"}}, Path("/runs/one"))["task"]["robot"]
        '/runs/one/model/robot/mine.toml'
    """
    task = dict(settings["task"])
    files = {name: str(folder.resolve() / task[name]) for name in COPIES if is_spec_file(task.get(name))}
    return {**settings, "task": {**task, **files}}

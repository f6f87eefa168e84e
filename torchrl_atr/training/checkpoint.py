"""Checkpoints: plain tensors and numbers, written atomically, loadable with ``weights_only=True``."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import torch

from torchrl_atr._errors import UserError
from torchrl_atr._files import atomic

VERSION = 1
NAME = "checkpoint.pt"


class CheckpointError(UserError, RuntimeError):
    """A checkpoint that is missing, damaged, or from another version."""


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Writes ``state`` beside ``path``, reads it back, then moves it into place: a crash leaves the old one.

    Args:
        path: of the checkpoint.
        state: nested dicts of tensors, numbers and strings.
    """
    with atomic(path) as temporary:
        with temporary.open("wb") as file:
            torch.save({"version": VERSION, **state}, file)
            file.flush()
            os.fsync(file.fileno())
        load_checkpoint(temporary)


def load_checkpoint(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Reads a checkpoint.

    Args:
        path: of the file, or of the run folder that holds it.
        device: where tensors go.

    Raises:
        CheckpointError: if it is missing, truncated, or of another version.
    """
    path = path / NAME if path.is_dir() else path
    if not path.is_file():
        raise CheckpointError(f"there is no checkpoint at {path}; give a run folder that `torchrl-atr train` wrote")
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except (RuntimeError, EOFError, OSError, pickle.UnpicklingError, KeyError, ValueError) as error:
        raise CheckpointError(
            f"the checkpoint {path} cannot be read, it may be truncated ({type(error).__name__}); restore the file or "
            "start a new run"
        ) from error
    if not isinstance(state, dict) or state.get("version") != VERSION:
        found = state.get("version") if isinstance(state, dict) else type(state).__name__
        raise CheckpointError(f"{path} has checkpoint version {found!r}; this code reads version {VERSION}")
    return state

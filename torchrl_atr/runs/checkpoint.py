"""Checkpoints: plain tensors and numbers, written atomically, loadable with ``weights_only=True``.

They replace :class:`torchrl.checkpoint.Checkpoint` and ``CheckpointRotation``, which were tried with the committed
run's 3.8 MB and have these faults: saving a step once more, as a run does at its end and when it is resumed, moves the
old file away first, and a kill in between leaves none that is recognised; a flipped bit is not detected in a folder,
and in an archive no earlier file replaces the damaged one; nothing is read back before it replaces the old file.
The states of the global random generators are TorchRL's.
"""

from __future__ import annotations

import io
import logging
import os
import pickle
import shlex
import shutil
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.checkpoint import GlobalRNGState

from torchrl_atr._errors import UserError
from torchrl_atr._files import atomic
from torchrl_atr.deploy.manifest import is_bundle
from torchrl_atr.deploy.weights import read_weights

VERSION = 4
"""Version of the contents and names of a checkpoint; a change of them adds a step to ``scripts/convert_run.py``."""
NAME, PREVIOUS, BEST = "checkpoint.pt", "previous.pt", "best.pt"
"""The last checkpoint of a run, the one before, and the one with the largest episode reward."""
LAST = "last"
CHOICES: Mapping[str, str | None] = {LAST: None, "best": BEST}
"""Files of the checkpoints to choose from, by the names that a user gives; None for the last, or the one before it."""
_LOG = logging.getLogger(__name__)


def rng_state() -> dict[str, Any]:
    """Return the states of the global generators of Python, numpy and torch, those of a GPU included."""
    return GlobalRNGState().state_dict()


def load_rng_state(state: Mapping[str, Any] | Tensor) -> None:
    """Restore :func:`rng_state`, or torch's alone from an earlier checkpoint, as far as there are such generators."""
    here = rng_state()
    saved = {"torch_cpu": state} if isinstance(state, Tensor) else state
    known = {name: value for name, value in saved.items() if name in here}
    if "torch_cuda" in known:
        known["torch_cuda"] = known["torch_cuda"][: len(here["torch_cuda"])]
    GlobalRNGState().load_state_dict({**here, **known})


class CheckpointError(UserError, RuntimeError):
    """Error of a checkpoint that is missing, damaged, or from another version."""


def save_checkpoint(path: Path, state: dict[str, Any], best: bool = False) -> None:
    """Write ``state`` beside ``path``, read it back, then move it into place: a crash leaves the old one.

    What ``path`` held before stays as ``previous.pt``; with ``best``, ``best.pt`` becomes this one too.

    Args:
        path: of the checkpoint.
        state: nested dicts of tensors, numbers and strings.
        best: whether it is the best one so far.

    Raises:
        OSError: if it cannot be written; names ``path``.
    """
    buffer = io.BytesIO()  # a full disk under torch.save is a RuntimeError about positions
    torch.save({"version": VERSION, **state}, buffer)
    with atomic(path) as temporary:
        with temporary.open("wb") as file:
            file.write(buffer.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        load_checkpoint(temporary)
        with suppress(FileNotFoundError, zipfile.BadZipFile):  # a damaged file must not replace the backup
            _check_whole(path)
            _name_too(path, path.with_name(PREVIOUS))
    if best:
        _name_too(path, path.with_name(BEST))


def _name_too(source: Path, target: Path) -> None:
    """Make ``target`` a second name of the file that ``source`` is now."""
    with atomic(target) as temporary:
        temporary.unlink()
        try:
            os.link(source, temporary)
        except OSError:  # some file systems have no links
            shutil.copyfile(source, temporary)


def load_checkpoint(path: str | Path, device: str = "cpu") -> dict[str, Any]:
    """Read a checkpoint; if the last one of a run folder is damaged or missing, the one before.

    Args:
        path: of the file, or of the folder that holds it: a run, or a policy bundle.
        device: where tensors go.

    Returns:
        The saved state, with its ``version``.

    Raises:
        CheckpointError: if it is missing, truncated, or of another version; says how an earlier one is converted.
        BundleError: if it is a bundle that is incomplete, changed, or of another version.
    """
    path = Path(path)
    if is_bundle(path):
        return {"version": VERSION, **read_weights(path)}
    run, file = (path, path / NAME) if path.is_dir() else (path.parent, path)
    try:
        state = read_checkpoint(file, device)
    except CheckpointError as error:
        file = path / PREVIOUS
        if not file.is_file():
            raise
        _LOG.warning("%s; taking %s instead", error, file)
        state = read_checkpoint(file, device)
    if (version := state["version"]) != VERSION:
        writer = state.get("provenance", {}).get("versions", {}).get("torchrl_atr")
        remedy = f"use the torchrl_atr that wrote it{f' ({writer})' if writer else ''}, or train anew"
        if isinstance(version, int) and 1 <= version < VERSION:
            remedy = f"convert it with `python scripts/convert_run.py {shlex.quote(str(run))}` of a clone, or {remedy}"
        raise CheckpointError(f"{file} has checkpoint version {version!r}; this code reads version {VERSION}: {remedy}")
    return state


def read_checkpoint(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Read a checkpoint of any version, such as one that is to be converted.

    Raises:
        CheckpointError: if it is missing, damaged, or not a checkpoint of this package.
    """
    if not path.is_file():
        raise CheckpointError(
            f"there is no checkpoint at {path}; give a run folder that `torchrl-atr train` wrote, or a name of "
            "`torchrl-atr list policies`"
        )
    try:
        _check_whole(path)
        state = torch.load(path, map_location=device, weights_only=True)
    except pickle.UnpicklingError as error:
        raise CheckpointError(
            f"{path} holds more than tensors and numbers, maybe code, and is not loaded; give a checkpoint that "
            "`torchrl-atr train` wrote"
        ) from error
    except (RuntimeError, zipfile.BadZipFile) as error:
        raise CheckpointError(
            f"the checkpoint {path} cannot be read, it may be truncated or another kind of file; restore the file or "
            "start anew"
        ) from error
    if not isinstance(state, dict) or "version" not in state:
        raise CheckpointError(f"{path} is not a checkpoint of ours; give a run folder that `torchrl-atr train` wrote")
    return state


def _check_whole(path: Path) -> None:
    """Compare checksums, which loading does not: a flipped bit is a wrong weight."""
    with zipfile.ZipFile(path) as archive:
        damaged = archive.testzip()
    if damaged is not None:
        raise zipfile.BadZipFile(damaged)

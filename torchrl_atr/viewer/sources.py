"""Policies that can be ridden from here: installed ones, the runs of a folder, and their checkpoints."""

from __future__ import annotations

from pathlib import Path

from torchrl_atr._errors import UserError
from torchrl_atr.deploy.manifest import is_bundle, policies
from torchrl_atr.runs.checkpoint import CHOICES, LAST, NAME

RUNS = Path("runs")
"""Folder whose runs are listed, where ``torchrl-atr train`` puts them by default."""


def ridable(given: Path | None = None, runs: Path = RUNS) -> dict[str, Path]:
    """Return the folders of policies that can be ridden, by the name that a list shows.

    Args:
        given: a run or bundle to list first, wherever it is.
        runs: folder whose runs are listed, newest first.

    Returns:
        Runs and bundles: the given one, the installed policies by their names, the runs by their paths.

    Example:
        >>> list(ridable(Path("results/ride"), runs=Path("no_such_folder")))[0]
        'results/ride'
    """
    installed = policies()
    found: dict[str, Path] = {}
    if given is not None:
        name = next((name for name, folder in installed.items() if folder == given), given.as_posix())
        found[name] = given
    found |= {name: folder for name, folder in installed.items() if name not in found}
    folders = [folder for folder in runs.iterdir() if (folder / NAME).is_file()] if runs.is_dir() else []
    for folder in sorted(folders, key=lambda folder: -(folder / NAME).stat().st_mtime):
        if given is None or folder.resolve() != given.resolve():
            found[folder.as_posix()] = folder
    return found


def default_policy(runs: Path = RUNS) -> Path:
    """Return the first installed policy, or the newest run.

    Raises:
        UserError: if there is neither; says how to get one.
    """
    for folder in ridable(runs=runs).values():
        return folder
    raise UserError(
        f"no policy is installed, and there is no run in {runs}/; train one for five minutes with `torchrl-atr train "
        "--max-minutes 5`, or give the folder of a run or of a policy bundle"
    )


def checkpoints_of(folder: Path) -> list[str]:
    """Return the names of a policy's checkpoints: ``last``, and ``best`` where the run has one."""
    return [name for name, file in CHOICES.items() if file is None or _has(folder, file)]


def stamp(folder: Path, checkpoint: str = LAST) -> tuple[int, int] | None:
    """Return what changes when a run writes a new checkpoint: time (ns) and size; None for a bundle, or no file."""
    try:
        status = (folder / (CHOICES[checkpoint] or NAME)).stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _has(folder: Path, file: str) -> bool:
    return not is_bundle(folder) and (folder / file).is_file()

"""Convert a run's checkpoints to the version that this code reads: ``python scripts/convert_run.py RUN [OUTPUT]``.

Without OUTPUT the run folder itself is converted; with it, a copy. What is of that version already stays as it is.

To change what a checkpoint holds: raise ``VERSION`` in ``torchrl_atr/training/checkpoint.py`` by one and append a
function to :data:`CONVERSIONS` that makes a state of the version before into one of the new version, in place.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch

sys.path.insert(0, str(Path(__file__).parents[1]))  # the version that this clone reads, whatever is installed

from torchrl_atr._errors import UserError
from torchrl_atr._files import atomic, write_json
from torchrl_atr.training.checkpoint import (
    BEST,
    NAME,
    PREVIOUS,
    VERSION,
    CheckpointError,
    read_checkpoint,
)

State = dict[str, Any]


def separate_exploration(state: State) -> None:
    """Make version 2 of 1: exploration is a module of its own, and optional inputs have lists of normalisers.

    Parameters are listed in the same order, so the optimisers' moments stay as they are.
    """
    _rename_weights(
        state,
        {
            "backbone.std.raw": "exploration.raw",
            "backbone.noise_basis": "exploration.basis",
            "backbone.head": "backbone.output_map",
            "extrinsic_estimator.side_norm.": "extrinsic_estimator.side_norms.0.",
            "critic.outlook_norm.": "critic.input_norms.0.",
        },
    )
    state["config"].setdefault("tracking_forecast", True)  # a profile might say otherwise


def describe_the_task(state: State) -> None:
    """Make version 3 of 2: the task has a name, command grids have options, envs save other entries.

    Episodes that were under way are dropped: a resumed run starts new ones, as one with workers does.
    """
    settings = state["config"]
    settings.setdefault("task", "riding")
    for old, new in {"steering_emphasis": "steering_weight_peak", "final_emphasis": "steering_weight_end"}.items():
        if old in settings:
            settings[new] = settings.pop(old)
    options = {"forward_only": False, "still": 0.0, "turning": 0.0, "straight": 0.0}
    state["curriculum"]["grid"] = {**options, **state["curriculum"]["grid"]}
    for member in (state, *state.get("members", [])):
        member["collection"] = {}


CONVERSIONS: tuple[Callable[[State], None], ...] = (separate_exploration, describe_the_task)
"""The first makes version 2 of 1, the next 3 of 2, and so on."""


def convert(state: State) -> None:
    """Convert a checkpoint's state to :data:`~torchrl_atr.training.checkpoint.VERSION`, in place.

    Raises:
        CheckpointError: if its version is unknown, or it lacks what one of that version holds.
    """
    version = state["version"]
    if not isinstance(version, int) or not 1 <= version <= VERSION:
        raise CheckpointError(f"version {version!r} is unknown here; versions 1 to {VERSION} can be converted")
    for conversion in CONVERSIONS[version - 1 :]:
        try:
            conversion(state)
        except KeyError as error:
            raise CheckpointError(f"it holds no {error}, as version {state['version']} does") from error
        state["version"] += 1


def convert_run(run: Path, output: Path | None = None) -> list[str]:
    """Convert the checkpoints and the settings of a run folder.

    Args:
        run: the folder.
        output: of a copy to convert in its place, which must not exist.

    Returns:
        The names of the files that were converted.

    Raises:
        CheckpointError: if there is no checkpoint, one cannot be read or converted, or ``output`` exists.
        OSError: if a file cannot be written.
    """
    files = [run / name for name in (NAME, PREVIOUS, BEST) if (run / name).is_file()]
    if not files:
        raise CheckpointError(f"there is no checkpoint in {run}; give a run folder that `torchrl-atr train` wrote")
    states = {path.name: read_checkpoint(path) for path in files}
    old = {name: state for name, state in states.items() if state["version"] != VERSION}
    for name, state in old.items():  # all of them, before anything is written
        try:
            convert(state)
        except CheckpointError as error:
            raise CheckpointError(f"{run / name} cannot be converted: {error}") from error
    if output is not None:
        if output.exists():
            raise CheckpointError(f"{output} exists; give a folder that does not")
        shutil.copytree(run, output)
        run = output
    for name, state in old.items():
        with atomic(run / name) as temporary:
            torch.save(state, temporary)
            read_checkpoint(temporary)
    if NAME in old and (run / "config.json").is_file():
        write_json(run / "config.json", old[NAME]["config"])
    return list(old)


def _rename_weights(state: State, names: Mapping[str, str]) -> None:
    """Rename the networks' weights, and their running mean, by what their names begin with."""
    learner = state["learner"]
    for part in ("networks", "deployed"):
        if part in learner or part == "networks":
            learner[part] = {_renamed(name, names): value for name, value in learner[part].items()}


def _renamed(name: str, names: Mapping[str, str]) -> str:
    for old, new in names.items():
        if name.startswith(old):
            return new + name.removeprefix(old)
    return name


def main(arguments: list[str] | None = None) -> int:
    """Convert the run that the command line names; return 2 if it cannot be done."""
    parser = argparse.ArgumentParser(description="Convert a run's checkpoints to the version that this code reads.")
    parser.add_argument("run", type=Path, metavar="RUN", help="folder that `torchrl-atr train` wrote")
    parser.add_argument("output", type=Path, metavar="OUTPUT", nargs="?", help="new folder for a converted copy")
    given = parser.parse_args(arguments)
    try:
        converted = convert_run(given.run, given.output)
    except (UserError, OSError) as error:
        print(f"convert_run: {error}", file=sys.stderr)
        return 2
    where = given.run if given.output is None else given.output
    print(f"{where}: {', '.join(converted) or 'nothing'} converted; all is of version {VERSION}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Copy what others need of a trained run into a small folder: ``python scripts/publish_run.py RUN OUTPUT``.

The checkpoint holds the deployed weights alone: a published run is evaluated, played and begun from (``--from``), with
optimisers that start anew. The log keeps every so many rows.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parents[1]))  # the version that this clone reads, whatever is installed

from torchrl_atr._errors import UserError
from torchrl_atr._files import atomic
from torchrl_atr.training import load_checkpoint
from torchrl_atr.training.checkpoint import NAME
from torchrl_atr.training.run_files import CONFIG, MODEL, ORIGIN, copy_log

ROWS = 500
"""Of the published log, at most."""


def publish(run: Path, output: Path) -> None:
    """Write checkpoint, settings, provenance, log and the robot's files of a run into ``output``.

    Raises:
        CheckpointError: if there is no checkpoint in ``run``, or one that cannot be read.
    """
    state = load_checkpoint(run)
    learner = state["learner"]
    learner["networks"] = learner["deployed"]  # the same tensors are stored once
    for optimizer in learner["optimizers"].values():
        optimizer["state"] = {}
    state["collection"] = {}  # episodes that were under way
    output.mkdir(parents=True, exist_ok=True)
    with atomic(output / NAME) as temporary:
        torch.save(state, temporary)
    for name in (CONFIG, ORIGIN):
        shutil.copyfile(run / name, output / name)
    if (run / MODEL).is_dir():
        shutil.copytree(run / MODEL, output / MODEL, dirs_exist_ok=True)
    copy_log(run, output, ROWS)


def main(arguments: list[str] | None = None) -> int:
    """Publish the run that the command line names; return 2 if that fails."""
    parser = argparse.ArgumentParser(description="Copy what others need of a trained run into a small folder.")
    parser.add_argument("run", type=Path, metavar="RUN", help="folder that `torchrl-atr train` wrote")
    parser.add_argument("output", type=Path, metavar="OUTPUT", help="folder to write into")
    given = parser.parse_args(arguments)
    try:
        publish(given.run, given.output)
    except (UserError, OSError) as error:
        print(f"publish_run: {error}", file=sys.stderr)
        return 2
    print(f"published {given.run} in {given.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

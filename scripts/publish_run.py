"""Copy what others need of a trained run into a small folder: ``python scripts/publish_run.py RUN OUTPUT``.

The checkpoint holds the deployed weights alone: a published run is evaluated, played and begun from (``--from``), with
optimisers that start anew. The log keeps every so many rows. Of the evaluations of ``python -m benchmarks.scorecard
RUN`` the figures and some pictures are copied, and the scorecard is written again. ``--film`` adds ``ride.gif``.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parents[1]))  # the version that this clone reads, whatever is installed

from benchmarks import scorecard
from torchrl_atr._errors import UserError
from torchrl_atr._files import atomic
from torchrl_atr.deploy.card import read_report
from torchrl_atr.runs.checkpoint import NAME
from torchrl_atr.runs.files import CONFIG, MODEL, ORIGIN, copy_log
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, load_checkpoint, load_run

ROWS = 500
"""Of the published log, at most."""
REPORT = "metrics.json"
PICTURES = {
    "tracking": ("command_area.png", "heatmaps.png", "response.png"),
    "area-15x2": ("heatmaps.png",),
    **dict.fromkeys(("endurance", "endurance-300", "standing-300"), ("endurance.png",)),
}
"""Pictures that are published, by evaluation."""
OF_THE_RUN = ("learning_curves.png", "curriculum.png")
"""Pictures that every evaluation of tracking makes anew."""
FILM = {"seconds": 12.0, "fps": 5.0, "size": (256, 192)}
"""Of ``ride.gif``: some 400 kB."""


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


def publish_evaluations(run: Path, output: Path) -> None:
    """Copy the figures and some pictures of a run's evaluations, and write the scorecard of those that there are."""
    rows = [name for name in scorecard.EVALUATIONS if (run / name / REPORT).is_file()]
    for name in rows:
        (output / name).mkdir(exist_ok=True)
        for file in (REPORT, *PICTURES.get(name, ())):
            shutil.copyfile(run / name / file, output / name / file)
    if "tracking" in rows:
        for file in OF_THE_RUN:
            shutil.copyfile(run / "tracking" / file, output / file)
    if rows:
        seed = read_report(output / rows[0] / REPORT)["evaluation"]["seed"]
        scorecard.measure(output, seed, rows)


def film(run: Path) -> None:
    """Film the deployed policy into ``ride.gif``."""
    from torchrl_atr.evaluation import record_video

    _, env, networks, _ = load_run(run, num_envs=1, **DEPLOYMENT_OVERRIDES)
    record_video(networks.deployed_policy(), env, run / "ride.gif", **FILM)


def main(arguments: list[str] | None = None) -> int:
    """Publish the run that the command line names; return 2 if that fails."""
    parser = argparse.ArgumentParser(description="Copy what others need of a trained run into a small folder.")
    parser.add_argument("run", type=Path, metavar="RUN", help="folder that `torchrl-atr train` wrote")
    parser.add_argument("output", type=Path, metavar="OUTPUT", help="folder to write into")
    parser.add_argument("--film", action="store_true", help="also write ride.gif")
    given = parser.parse_args(arguments)
    try:
        publish(given.run, given.output)
        publish_evaluations(given.run, given.output)
        if given.film:
            film(given.output)
    except (UserError, OSError) as error:
        print(f"publish_run: {error}", file=sys.stderr)
        return 2
    print(f"published {given.run} in {given.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""SIGKILL at random moments of a run: the last checkpoint must load, and the run must go on from it.

``python -m benchmarks.kills`` starts a small run that saves after every iteration, kills it some time after its first
checkpoint (while it collects, learns or saves), reads the checkpoint, goes on from it with ``--resume``, kills again.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchrl_atr._files import atomic
from torchrl_atr.training import CheckpointError, load_checkpoint
from torchrl_atr.training.checkpoint import NAME
from torchrl_atr.training.provenance import machine
from torchrl_atr.training.trainer import write_json

SETTINGS = ("num_envs=8", "rollout_steps=4", "minibatches=1", "epochs=1", "num_threads=1", "checkpoint_seconds=0")
_PATIENCE = 120.0
"""Seconds in which a run must have begun to save."""


def kill_once(run: Path, delay: float) -> dict[str, Any]:
    """Starts or resumes a run, kills it, and looks at what it left.

    Args:
        run: the run folder; resumed if it holds a checkpoint.
        delay: seconds between this start's first iteration and the kill.

    Returns:
        ``frames`` of the checkpoint before and after, ``temporary``, whether the kill left a half-written file, and
        ``lost``, why the run could not go on from where it was killed, or None.
    """
    before = load_checkpoint(run)["frames"] if run.is_dir() else 0
    start = ["--resume", str(run)] if run.is_dir() else ["--output", str(run), "--total-frames", "1e12"]
    if not run.is_dir():
        start += [part for setting in SETTINGS for part in ("--set", setting)]
    process = subprocess.Popen(
        [sys.executable, "-m", "torchrl_atr.cli", "train", *start],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        lost = _wait_for_progress(process, run, before)
        time.sleep(delay)
    finally:
        process.kill()
        _, errors = process.communicate()
    if lost is not None:
        return {"before": before, "after": before, "temporary": False, "lost": f"{lost}: {errors.strip()[-200:]}"}
    temporary = any(f".{process.pid}.part" in file.name for file in run.iterdir())
    try:
        after = load_checkpoint(run / NAME)["frames"]  # itself, not the one before that would stand in
    except CheckpointError as error:
        return {"before": before, "after": None, "temporary": temporary, "lost": str(error)}
    lost = None if after > before else "the checkpoint is older than the one that the run went on from"
    return {"before": before, "after": after, "temporary": temporary, "lost": lost}


def _wait_for_progress(process: subprocess.Popen[str], run: Path, frames: int) -> str | None:
    """Returns once the checkpoint is of more than ``frames``; otherwise says what happened instead."""
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        if process.poll() is not None:
            return f"the run ended by itself with code {process.returncode}"
        if (run / NAME).is_file() and load_checkpoint(run)["frames"] > frames:
            return None
        time.sleep(0.05)
    return f"no checkpoint within {_PATIENCE:g} s"


def table(report: dict[str, Any]) -> str:
    """The report as Markdown."""
    kills, hardware = report["kills"], report["hardware"]
    cores = f"{hardware['cpus']} core{'s' * (hardware['cpus'] > 1)}"
    lines = [
        "# Killed runs",
        "",
        f"`{report['command']}`: {report['wall_seconds']:.0f} s on {cores} ({hardware['processor']}).",
        "",
        f"{len(kills)} kills (SIGKILL) of a run that saves after every iteration, each up to {report['longest']:g} s "
        f"after its first checkpoint; {sum(kill['temporary'] for kill in kills)} of them left a half-written temporary "
        "file. "
        f"Lost: {sum(kill['lost'] is not None for kill in kills)}.",
        "",
        "| kill | seconds after the first checkpoint | frames before | frames in the checkpoint left | lost |",
        "| --- | --- | --- | --- | --- |",
    ]
    for number, kill in enumerate(kills, start=1):
        cells = (number, f"{kill['delay']:.2f}", kill["before"], kill["after"], kill["lost"] or "no")
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join([*lines, ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Kills, resumes, reports; exit code 1 if anything was lost."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/kills"), metavar="FOLDER")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--longest", type=float, default=3.0, help="seconds from the first checkpoint to the kill")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    arguments = parser.parse_args(argv)
    moments, started, kills = random.Random(arguments.seed), time.monotonic(), []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(arguments.kills):
            delay = moments.uniform(0.0, arguments.longest)
            kills.append({"delay": delay, **kill_once(Path(folder) / "run", delay)})
            sys.stdout.write(f"{len(kills)} of {arguments.kills}: {kills[-1]}\n")
            sys.stdout.flush()
            if kills[-1]["lost"] is not None:
                break
    report = {
        "command": f"python -m benchmarks.kills --kills {arguments.kills} --longest {arguments.longest:g} "
        f"--seed {arguments.seed}",
        "longest": arguments.longest,
        "wall_seconds": round(time.monotonic() - started, 1),
        "kills": kills,
        **machine(),
    }
    write_json(arguments.output / "kills.json", report)
    with atomic(arguments.output / "README.md") as file:
        file.write_text(table(report))
    return int(any(kill["lost"] is not None for kill in kills))


if __name__ == "__main__":
    sys.exit(main())

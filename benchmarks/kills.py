"""SIGKILL at random moments of a run: the last checkpoint must load, and the run must continue from it.

``python -m benchmarks.kills`` starts a small run that saves after every iteration, kills it, reads the checkpoint,
continues from it with ``--resume`` and kills again: in turns some time after the first checkpoint of that start, while
it collects, learns or saves, and some time after the start of the process.
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

from benchmarks import results
from torchrl_atr._files import say
from torchrl_atr.runs.checkpoint import NAME
from torchrl_atr.runs.provenance import machine
from torchrl_atr.training import CheckpointError, load_checkpoint

SETTINGS = (
    *("--num-envs", "8", "--ppo.rollout-steps", "4", "--ppo.minibatches", "1", "--ppo.epochs", "1"),
    *("--compute.num-threads", "1", "--logging.checkpoint-seconds", "0"),
)
_PATIENCE = 120.0
"""Seconds within which a run must have saved a checkpoint."""


def kill_once(run: Path, delay: float, from_start: bool = False) -> dict[str, Any]:
    """Start or resume a run, kill it, and check the files that remain.

    Args:
        run: the run folder; resumed if it holds a checkpoint.
        delay: seconds until the kill.
        from_start: whether they count from the start of the process, imports and the first save included, instead of
            from the first checkpoint that is newer than the one it resumed from.

    Returns:
        ``before`` and ``after``, frames of the checkpoint, ``temporary``, whether the kill left a half-written file,
        and ``lost``, the reason why the run cannot continue from where it was killed, or None.
    """
    known = (run / NAME).is_file()
    before = load_checkpoint(run / NAME)["frames"] if known else 0
    start = ["--resume", str(run)] if known else ["--output", str(run), "--overwrite", "--total-frames", "1e12"]
    if not known:
        start += SETTINGS
    process = subprocess.Popen(
        [sys.executable, "-m", "torchrl_atr.cli", "train", *start],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
    )
    try:
        lost = None if from_start else _wait_for_progress(process, run, before)
        time.sleep(delay)
        if lost is None and process.poll() is not None:
            lost = f"the run ended by itself with code {process.returncode}"
    finally:
        process.kill()
        _, errors = process.communicate()
    left = list(run.iterdir()) if run.is_dir() else []
    result = {"before": before, "after": before, "temporary": any(f".{process.pid}.part" in f.name for f in left)}
    if lost is not None:
        return {**result, "lost": f"{lost}: {errors.strip()[-200:]}"}
    if from_start and not known and not (run / NAME).is_file():
        return {**result, "lost": None}  # there was nothing to lose yet
    try:
        result["after"] = load_checkpoint(run / NAME)["frames"]  # this file, without falling back to the previous one
    except CheckpointError as error:
        return {**result, "lost": str(error)}
    gone_on = result["after"] >= before if from_start else result["after"] > before
    return {**result, "lost": None if gone_on else "the checkpoint is older than the one that the run went on from"}


def _wait_for_progress(process: subprocess.Popen[str], run: Path, frames: int) -> str | None:
    """Wait for a checkpoint of more than ``frames``; return None, or the reason why there is none."""
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline:
        if process.poll() is not None:
            return f"the run ended by itself with code {process.returncode}"
        if (run / NAME).is_file() and load_checkpoint(run)["frames"] > frames:
            return None
        time.sleep(0.05)
    return f"no checkpoint within {_PATIENCE:g} s"


def table(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    kills = report["kills"]
    lines = [
        "# Killed runs",
        "",
        results.origin(report),
        "",
        f"{len(kills)} kills (SIGKILL) of a run that saves after every iteration, in turns up to "
        f"{report['longest']:g} s after its first checkpoint and up to {report['start']:g} s after the start of the "
        f"process; {sum(kill['temporary'] for kill in kills)} of them left a half-written file. "
        f"Lost: {sum(kill['lost'] is not None for kill in kills)}.",
        "",
        "| kill | seconds | after | frames before | frames in the checkpoint left | half-written file | lost |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for number, kill in enumerate(kills, start=1):
        after, half = "start" if kill["from_start"] else "checkpoint", "yes" if kill["temporary"] else "no"
        cells = (number, f"{kill['delay']:.2f}", after, kill["before"], kill["after"], half, kill["lost"] or "no")
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join([*lines, ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Kill, resume and report; exit code 1 if anything was lost."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/kills"), metavar="FOLDER")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--longest", type=float, default=3.0, help="seconds from the first checkpoint to the kill")
    parser.add_argument("--start", type=float, default=12.0, help="seconds from the start of the process to the kill")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    arguments = parser.parse_args(argv)
    moments, started, kills = random.Random(arguments.seed), time.monotonic(), []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(arguments.kills):
            from_start = number % 2 == 1
            delay = moments.uniform(0.0, arguments.start if from_start else arguments.longest)
            killed = kill_once(Path(folder) / "run", delay, from_start)
            kills.append({"delay": delay, "from_start": from_start, **killed})
            say(f"{len(kills)} of {arguments.kills}: {kills[-1]}")
            if kills[-1]["lost"] is not None:
                break
    report = {
        "command": f"python -m benchmarks.kills --kills {arguments.kills} --longest {arguments.longest:g} "
        f"--start {arguments.start:g} --seed {arguments.seed}",
        "longest": arguments.longest,
        "start": arguments.start,
        "wall_seconds": round(time.monotonic() - started, 1),
        "kills": kills,
        **machine(),
    }
    results.write(arguments.output, "kills", report, table(report))
    return int(any(kill["lost"] is not None for kill in kills))


if __name__ == "__main__":
    sys.exit(main())

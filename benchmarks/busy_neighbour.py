"""Speed of training and evaluation beside other processes: alone, beside one busy process, and two at once.

``python -m benchmarks.busy_neighbour`` runs the command line as a user does, all cases in turns, and compares medians.
A busy process is one that never sleeps.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import results
from torchrl_atr._cpus import available_cpus
from torchrl_atr._files import say
from torchrl_atr.runs.files import LOG
from torchrl_atr.runs.provenance import machine

_BUSY = [sys.executable, "-c", "while True: pass"]
_COMMAND = [sys.executable, "-m", "torchrl_atr.cli"]
_WARM_UP = 0.1
"""Minutes at the start of a run that do not count: cold caches, and the first measurements of other processes."""


@contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """Keep ``count`` processes busy inside the block."""
    processes = [subprocess.Popen(_BUSY) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def train(folder: Path, minutes: float, count: int = 1) -> float:
    """Train ``count`` runs at once; return the robot steps per second of the slowest."""
    runs = [folder / f"run{number}" for number in range(count)]
    common = ["train", "--overwrite", "--max-minutes", f"{minutes + _WARM_UP:g}", "--output"]
    processes = [subprocess.Popen([*_COMMAND, *common, str(run)], stdout=subprocess.DEVNULL) for run in runs]
    for process in processes:
        if process.wait() != 0:
            raise SystemExit(f"a training ended with code {process.returncode}")
    return min(map(_speed, runs))


def _speed(run: Path) -> float:
    with (run / LOG).open(newline="", encoding="utf-8") as file:
        rows = [(float(row["minutes"]), float(row["frames"])) for row in csv.DictReader(file)]
    (began, before), *_ = [row for row in rows if row[0] >= _WARM_UP]
    ended, after = rows[-1]
    return (after - before) / (60 * (ended - began))


def evaluate(folder: Path) -> float:
    """Evaluate a run; return evaluations per minute."""
    started = time.monotonic()
    subprocess.run(
        [*_COMMAND, "evaluate", str(folder / "run0"), "--output", str(folder / "report"), "--robots-per-command", "16"],
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return 60 / (time.monotonic() - started)


def measure(folder: Path, minutes: float, rounds: int) -> dict[str, list[float]]:
    """Measure every case in every round; return the speeds by case."""
    speeds: dict[str, list[float]] = {}
    for number in range(1, rounds + 1):
        speeds.setdefault("train alone", []).append(train(folder, minutes))
        speeds.setdefault("evaluate alone", []).append(evaluate(folder))
        with busy_processes(1):
            speeds.setdefault("train beside a busy process", []).append(train(folder, minutes))
            speeds.setdefault("evaluate beside a busy process", []).append(evaluate(folder))
        speeds.setdefault("each of two trainings", []).append(train(folder, minutes, count=2))
        say(f"{number} of {rounds}: " + ", ".join(f"{case} {values[-1]:,.4g}" for case, values in speeds.items()))
    return speeds


def table(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    lines = [
        "# Beside other work",
        "",
        results.origin(report),
        "",
        "Training: robot steps a second with the default settings, the slower of two runs. Evaluation: evaluations a "
        "minute, process start included. Medians of rounds in turns; ratios to the same alone.",
        "",
        "| case | median | range | ratio |",
        "| --- | --- | --- | --- |",
    ]
    for case, values in report["speeds"].items():
        style = ",.0f" if "train" in case else ".2f"
        spread = f"{min(values):{style}} to {max(values):{style}}"
        lines.append(f"| {case} | {median(values):{style}} | {spread} | {report['ratios'].get(case, 1.0):.2f} |")
    return "\n".join([*lines, ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and write ``busy_neighbour.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.busy_neighbour", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/busy_neighbour"), metavar="FOLDER")
    parser.add_argument("--minutes", type=float, default=0.4, help="of each training, after its warm-up")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args(argv)
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        speeds = measure(Path(folder), arguments.minutes, arguments.rounds)
    alone = {case: f"{'evaluate' if 'evaluate' in case else 'train'} alone" for case in speeds}
    report = {
        "command": f"python -m benchmarks.busy_neighbour --minutes {arguments.minutes:g} --rounds {arguments.rounds}",
        "cpus": available_cpus(),
        "speeds": speeds,
        "ratios": {case: median(values) / median(speeds[alone[case]]) for case, values in speeds.items()},
        "wall_seconds": round(time.monotonic() - started, 1),
        **machine(),
    }
    results.write(arguments.output, "busy_neighbour", report, table(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Training iterations with the learner on the CPU and on the GPU, physics on the CPU for both.

``python -m benchmarks.devices`` measures them in turns at several numbers of robots, and reports frames/s and the times
of collecting and learning. Without a CUDA device it measures the CPU alone and reports that.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks import results
from benchmarks.training import TrainingLoop
from torchrl_atr._compilation import compiler
from torchrl_atr._files import say
from torchrl_atr.runs.provenance import machine
from torchrl_atr.training import TrainConfig, make_config

COLUMNS = {"frames_per_second": "robot steps/s", "collect_seconds": "collecting, s", "learn_seconds": "learning, s"}
"""Reported metrics of an iteration, and their labels."""


def measure(loops: Sequence[TrainingLoop], rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Measure the medians over the iterations of every loop.

    Args:
        loops: training loops, measured in turns.
        rounds: turns of each, after one that is not counted.
        seconds: least length of a turn.

    Returns:
        ``num_envs``, ``device`` and a value for each of :data:`COLUMNS`, by loop.
    """
    samples: list[list[dict[str, float]]] = [[] for _ in loops]
    for turn in range(rounds + 1):
        say(f"round {turn} of {rounds}" if turn else "warming up")
        for loop, kept in zip(loops, samples):
            iterations = _turn(loop, seconds)
            kept += iterations if turn else []
    return [
        {
            "num_envs": loop.config.env.num_envs,
            "device": loop.config.compute.device,
            **{name: statistics.median(metrics[name] for metrics in kept) for name in COLUMNS},
        }
        for loop, kept in zip(loops, samples)
    ]


def _turn(loop: TrainingLoop, seconds: float) -> list[dict[str, float]]:
    """Return the metrics of as many iterations as fill ``seconds``, after one whose time includes the others' turns."""
    loop.trainer.iterate()
    iterations: list[dict[str, float]] = []
    start = time.perf_counter()
    while not iterations or time.perf_counter() - start < seconds:
        iterations.append(loop.trainer.iterate())
    return iterations


def table(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    lines = [
        "# The learner on a GPU",
        "",
        results.origin(report),
        "",
        f"Training iterations of {TrainConfig().ppo.rollout_steps} control steps, A1 on the single board, medians. "
        "Physics is on the CPU for both; collecting includes the policy, which is where the learner is.",
        "",
        f"| robots | learner | {' | '.join(COLUMNS.values())} |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in report["rows"]:
        seconds = " | ".join(f"{row[name]:.3f}" for name in ("collect_seconds", "learn_seconds"))
        lines.append(f"| {row['num_envs']} | {row['device']} | {row['frames_per_second']:,.0f} | {seconds} |")
    if all(row["device"] == "cpu" for row in report["rows"]):
        lines += ["", "Nothing was measured on a CUDA device there."]
    return "\n".join([*lines, ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Measure all and write ``devices.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.devices", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/devices"), metavar="FOLDER")
    parser.add_argument("--num-envs", type=int, nargs="+", default=[512, 1024, 2048, 4096])
    parser.add_argument("--devices", nargs="+", default=["cpu", *(["cuda"] if torch.cuda.is_available() else [])])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=2.0, help="of a turn")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE")
    arguments = parser.parse_args(argv)
    return results.exit_code("devices", partial(_compare, arguments))


def _compare(arguments: argparse.Namespace) -> None:
    started = time.monotonic()
    loops: list[TrainingLoop] = []
    with tempfile.TemporaryDirectory() as scratch:
        try:
            for size in arguments.num_envs:
                for device in arguments.devices:
                    say(f"{size} robots, learner on {device}")
                    values = {
                        "env.num_envs": size,
                        "compute.device": device,
                        "compute.compiled": compiler() is not None,
                    }
                    config = make_config(values, results.parse_overrides(arguments.overrides))
                    loops.append(TrainingLoop(config, Path(scratch) / f"{device}{size}"))
            rows = measure(loops, arguments.rounds, arguments.seconds)
        finally:
            for loop in loops:
                loop.close()
    sizes, devices = " ".join(map(str, arguments.num_envs)), " ".join(arguments.devices)
    settings = "".join(f" --set {text}" for text in arguments.overrides)
    report = {
        "command": f"python -m benchmarks.devices --num-envs {sizes} --devices {devices} --rounds {arguments.rounds} "
        f"--seconds {arguments.seconds:g}{settings}",
        "rows": rows,
        "wall_seconds": round(time.monotonic() - started, 1),
        **machine(arguments.devices[-1]),
    }
    results.write(arguments.output, "devices", report, table(report))


if __name__ == "__main__":
    sys.exit(main())

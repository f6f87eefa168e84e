"""Comparison of training with two workers and with one process: returns of short runs, three seeds each.

``python -m benchmarks.workers`` trains A1 on the single board with ``collector=direct`` and with ``process`` and two
workers, and compares the mean episode reward of the last tenth of each run.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import results
from torchrl_atr._files import say
from torchrl_atr.runs.provenance import machine
from torchrl_atr.training import Trainer, make_config

KINDS: dict[str, dict[str, Any]] = {
    "one process": {"compute.collector": "direct"},
    "two workers": {"compute.collector": "process", "compute.workers": 2},
}


def final_return(settings: dict[str, Any], folder: Path) -> float:
    """Train a run and return its mean episode reward over the last tenth of the iterations.

    Args:
        settings: of the run.
        folder: of the run.
    """
    rewards: list[float] = []
    config = make_config(settings)
    trainer = Trainer(config, folder)
    trainer.train(lambda metrics: rewards.append(metrics.get("episode_reward", float("nan"))))
    if not trainer.finished:  # training was stopped
        raise KeyboardInterrupt
    last = [reward for reward in rewards[-max(1, len(rewards) // 10) :] if reward == reward]
    return sum(last) / len(last) if last else float("nan")


def table(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    returns = report["returns"]
    low, high = min(returns["one process"]), max(returns["one process"])
    inside = sum(low <= value <= high for value in returns["two workers"])
    lines = [
        "# Two workers and one process",
        "",
        results.origin(report),
        "",
        f"Mean episode reward over the last tenth of {report['frames']:,} robot steps, A1 on the single board. "
        f"{inside} of the {len(returns['two workers'])} runs with two workers lie between the least and the largest of "
        "one process.",
        "",
        "| seed | one process | two workers |",
        "| --- | --- | --- |",
    ]
    lines += [f"| {seed} | {one:.2f} | {two:.2f} |" for seed, (one, two) in enumerate(zip(*returns.values()))]
    return "\n".join([*lines, ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Train all and write ``workers.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.workers", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/workers"), metavar="FOLDER")
    parser.add_argument("--frames", type=int, default=400_000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--num-envs", type=int, default=256)
    arguments = parser.parse_args(argv)
    started, returns = time.monotonic(), {}
    with tempfile.TemporaryDirectory() as folder:
        for kind, settings in KINDS.items():
            common = {"total_frames": arguments.frames, "env.num_envs": arguments.num_envs, **settings}
            returns[kind] = [
                final_return({**common, "seed": seed}, Path(folder) / f"{settings['compute.collector']}{seed}")
                for seed in range(arguments.seeds)
            ]
            say(f"{kind}: {returns[kind]}")
    report = {
        "command": f"python -m benchmarks.workers --frames {arguments.frames} --seeds {arguments.seeds} "
        f"--num-envs {arguments.num_envs}",
        "frames": arguments.frames,
        "returns": returns,
        "wall_seconds": round(time.monotonic() - started, 1),
        **machine(),
    }
    results.write(arguments.output, "workers", report, table(report))
    return 0


if __name__ == "__main__":  # workers are spawned: they import this file
    sys.exit(main())

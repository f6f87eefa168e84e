"""Training of the default recipe from scratch with several seeds, and evaluation of each deployed policy.

``python -m benchmarks.default_recipe`` continues where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import results
from torchrl_atr._files import say, write_json
from torchrl_atr.evaluation import evaluate_tracking, tracking_metrics
from torchrl_atr.runs.provenance import cores, machine
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, load_run, make_config, make_env

FIGURES = {
    "survival": ("robots still up after 10 s", "{:.1%}"),
    "settled_speed_error_straight": ("settled speed error, straight, m/s", "{:.3f}"),
    "settled_speed_error": ("settled speed error, all commands, m/s", "{:.3f}"),
    "settled_yaw_error": ("settled yaw rate error, rad/s", "{:.3f}"),
    "yaw_slope": ("slope of yaw rate on its command", "{:.3f}"),
}
"""Reported figures: label with unit, and format."""
EVALUATION = "evaluation.json"
"""Name of the file in a run's folder."""


def evaluate(run: Path) -> dict[str, Any]:
    """Evaluate a run: figures of the deployed policy, those of a board that never moves, and the run's provenance."""
    config, env, networks, state = load_run(run, num_envs=1)
    env.close()
    result = evaluate_tracking(
        networks.deployed_policy(), partial(make_env, config, **DEPLOYMENT_OVERRIDES), seed=config.seed + 1
    )
    metrics = tracking_metrics(result)
    still = {name: metrics["do_nothing"][name] for name in FIGURES}
    return {**{name: metrics[name] for name in FIGURES}, "still": still, "n": metrics["n"], "run": state["provenance"]}


def spread(runs: Sequence[dict[str, Any]], name: str) -> str:
    """Return the median of a figure over runs, with its smallest and largest value."""
    values, style = [run[name] for run in runs], FIGURES[name][1]
    middle, low, high = (style.format(value) for value in (median(values), min(values), max(values)))
    return f"{middle} ({low} to {high})"


def table(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    runs, names = report["runs"], list(FIGURES)
    heads = ["seed", "minutes", *(FIGURES[name][0] for name in names)]
    lines = [
        "# The default recipe",
        "",
        f"`{report['command']}`: A1 on the single board, {runs[0]['run']['frames']:,} robot steps from scratch each.",
        "",
        f"Deployed: proprioception only. {runs[0]['n']} robots, 10 s from rest without pushes, fresh intrinsics of the "
        "training range, |c_v| <= 2 m/s and |c_ω| <= 1 rad/s.",
        "",
        f"| {' | '.join(heads)} | trained on |",
        f"| {' | '.join('---' for _ in heads)} | --- |",
    ]
    for run in runs:
        values = (FIGURES[name][1].format(run[name]) for name in names)
        origin = run["run"]
        lines.append(
            f"| {origin['seed']} | {origin['minutes']:.1f} | {' | '.join(values)} | {cores(origin['hardware'])} |"
        )
    lines.append(f"| median (range) | - | {' | '.join(spread(runs, name) for name in names)} | - |")
    return "\n".join([*lines, ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Train and evaluate all seeds; write ``default_recipe.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.default_recipe", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/default_recipe"), metavar="FOLDER")
    parser.add_argument("--runs", type=Path, default=Path("runs/default_recipe"), metavar="FOLDER", help="to continue")
    parser.add_argument("--frames", type=int, default=4_000_000, help="robot steps of each run")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    arguments = parser.parse_args(argv)
    return results.exit_code("default_recipe", partial(_train_all, arguments))


def _train_all(arguments: argparse.Namespace) -> None:
    configs = {
        arguments.runs / str(seed): make_config({"seed": seed, "total_frames": arguments.frames})
        for seed in arguments.seeds
    }
    for run, config in configs.items():
        results.refuse_other_settings(config, run)
    for run, config in configs.items():
        if not (run / EVALUATION).is_file():
            results.train(config, run)
            write_json(run / EVALUATION, evaluate(run))
        say(f"{run}: {(run / EVALUATION).read_text(encoding='utf-8')}")
    seeds = " ".join(map(str, arguments.seeds))
    report = {
        "command": f"python -m benchmarks.default_recipe --frames {arguments.frames} --seeds {seeds}",
        "runs": [json.loads((run / EVALUATION).read_text(encoding="utf-8")) for run in configs],
        "versions": machine()["versions"],
    }
    results.write(arguments.output, "default_recipe", report, table(report))


if __name__ == "__main__":
    sys.exit(main())

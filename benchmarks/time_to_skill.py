"""Minutes and robot steps of training until a skill is reached: A1 on the single board, from scratch, several seeds.

``python -m benchmarks.time_to_skill`` trains until the deployed policy meets the bar. It is evaluated every few
minutes, as by ``torchrl-atr evaluate``, which does not count as training time. Three seeds take hours: stopped and
called again, it continues where it was. Seeds may be trained side by side, one process and one core each: every call
reports all runs in the folder.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import results
from torchrl_atr._files import say, write_json
from torchrl_atr.evaluation import command_grid, evaluate_tracking, tracking_metrics
from torchrl_atr.runs.checkpoint import NAME
from torchrl_atr.runs.files import ORIGIN
from torchrl_atr.runs.provenance import cores, machine
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, TrainConfig, Trainer, load_checkpoint, make_config, make_env

BAR = {"survival": (0.97, 1.0), "settled_speed_error": (0.0, 0.30), "settled_yaw_error": (0.0, 0.25)}
"""Least and largest value of each figure: share, m/s, rad/s."""
GRID = (2.0, 1.0, 1.0, 0.25)
"""Largest speed (m/s) and yaw rate (rad/s) of the commands, and their steps."""
RECIPE = {
    "total_frames": 14_000_000,
    "curriculum.max_speed": 3.0,
    "curriculum.max_yaw_rate": 1.4,
    "exploration.anneal_from": 0.5,
    "exploration.anneal_until": 0.8,
    "exploration.final_std": 0.08,
    "task.steering_weight_peak": 3.0,
}
"""Differences from the default recipe: commands stay near those of the bar, and the steering reward has a larger weight
until steering, the last skill, is learned."""

NOTES = "evaluations.json"
"""Name of the file in a run's folder."""


def meets(figures: Mapping[str, float | None]) -> bool:
    """Return whether every figure is within the bar.

    Example:
        >>> meets({"survival": 0.98, "settled_speed_error": 0.2, "settled_yaw_error": 0.2})
        True
        >>> meets({"survival": 0.98, "settled_speed_error": None, "settled_yaw_error": 0.2})
        False
    """
    for name, (low, high) in BAR.items():
        value = figures[name]
        if value is None or not low <= value <= high:
            return False
    return True


def evaluate(trainer: Trainer, config: TrainConfig, robots_per_command: int) -> dict[str, Any]:
    """Evaluate the deployed policy; return the figures of the bar."""
    networks = trainer.learner.deployed
    result = evaluate_tracking(
        networks.deployed_policy(),
        partial(make_env, config, **DEPLOYMENT_OVERRIDES),
        command_grid(*GRID),
        robots_per_command=robots_per_command,
        seed=config.seed + 1,
        encoder_module=networks.encoder_module,
    )
    metrics = tracking_metrics(result)
    return {name: metrics[name] for name in BAR}


def train_until(config: TrainConfig, folder: Path, every: float, robots_per_command: int) -> list[dict[str, Any]]:
    """Train until the bar is met or the run ends; continue the run in ``folder`` if there is one.

    Args:
        config: ``max_minutes`` limits the run.
        folder: of the run.
        every: minutes of training between two evaluations.
        robots_per_command: of an evaluation.

    Returns:
        ``minutes``, ``frames`` and figures of every evaluation; the last one met the bar, or the run ended.
    """
    notes = folder / NOTES
    state = load_checkpoint(folder) if (folder / NAME).exists() else None
    tried: list[dict[str, Any]] = (
        json.loads(notes.read_text(encoding="utf-8")) if state is not None and notes.exists() else []
    )
    if tried and meets(tried[-1]):
        return tried
    trainer = Trainer(config, folder, state)
    if tried and trainer.finished:
        return tried

    def check(metrics: dict[str, float]) -> bool:
        if metrics["minutes"] < every * (len(tried) + 1) and not trainer.finished:
            return False
        figures = evaluate(trainer, config, robots_per_command)
        tried.append({"minutes": metrics["minutes"], "frames": int(metrics["frames"]), **figures})
        write_json(notes, tried)
        say(f"seed {config.seed}: {tried[-1]}")
        return meets(figures)

    if trainer.train(check) is not None:  # training was stopped
        raise KeyboardInterrupt
    return tried


def finished_runs(runs: Path) -> list[dict[str, Any]]:
    """Return seed, hardware and evaluations of every run in a folder, whichever call made it."""
    found = []
    for notes in sorted(runs.glob(f"*/{NOTES}")):
        origin = json.loads((notes.parent / ORIGIN).read_text(encoding="utf-8"))
        evaluations = json.loads(notes.read_text(encoding="utf-8"))
        found.append({"seed": origin["seed"], "hardware": origin["hardware"], "evaluations": evaluations})
    return found


def table(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    runs = report["runs"]
    skilled = [run for run in runs if meets(run["evaluations"][-1])]
    lines = [
        "# Time to skill",
        "",
        f"`{report['command']}`.",
        "",
        "The bar, deployed, over |c_v| <= 2 m/s and |c_ω| <= 1 rad/s: at least 97% up after 10 s, settled errors of at "
        f"most 0.30 m/s and 0.25 rad/s. {len(skilled)} of {len(runs)} seeds met it. {_median(runs)}",
        "",
        "| seed | minutes | robot steps | up | speed error, m/s | yaw error, rad/s | met | trained on |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for run in runs:
        last = run["evaluations"][-1]
        met, where = "yes" if run in skilled else "no", cores(run["hardware"])
        lines.append(f"| {run['seed']} | {_evaluation(last)} | {met} | {where} |")
    lines += [
        "",
        "## On the way",
        "",
        "| seed | minutes | robot steps | up | speed error, m/s | yaw error, rad/s |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    lines += [f"| {run['seed']} | {_evaluation(each)} |" for run in runs for each in run["evaluations"]]
    return "\n".join([*lines, ""])


def _median(runs: Sequence[dict[str, Any]]) -> str:
    """Return a sentence with the minutes and robot steps of the median seed, if it met the bar."""
    ends = sorted((run["evaluations"][-1] for run in runs), key=lambda end: (not meets(end), end["minutes"]))
    end = ends[len(ends) // 2]
    if not meets(end):
        return "The median seed did not."
    return f"Median: {end['minutes']:.1f} minutes, {end['frames']:,} robot steps."


def _evaluation(figures: Mapping[str, Any]) -> str:
    """Return the cells of one evaluation."""
    values = " | ".join("-" if figures[name] is None else f"{figures[name]:.3f}" for name in BAR)
    return f"{figures['minutes']:.1f} | {figures['frames']:,} | {values}"


def main(argv: Sequence[str] | None = None) -> int:
    """Train all seeds and write ``time_to_skill.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.time_to_skill", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/time_to_skill"), metavar="FOLDER")
    parser.add_argument("--runs", type=Path, default=Path("runs/time_to_skill"), metavar="FOLDER", help="to continue")
    parser.add_argument("--minutes", type=float, default=60.0, help="of training, at most, for each seed")
    parser.add_argument("--every", type=float, default=5.0, help="minutes between evaluations")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--robots-per-command", type=int, default=8)
    arguments = parser.parse_args(argv)
    return results.exit_code("time_to_skill", partial(_train_all, arguments))


def _train_all(arguments: argparse.Namespace) -> None:
    configs = {}
    for seed in arguments.seeds:
        values = {**RECIPE, "seed": seed, "max_minutes": arguments.minutes}
        configs[arguments.runs / str(seed)] = make_config(values, results.parse_overrides(arguments.overrides))
    for folder, config in configs.items():
        results.refuse_other_settings(config, folder)
    for folder, config in configs.items():
        train_until(config, folder, arguments.every, arguments.robots_per_command)
        runs = finished_runs(arguments.runs)
        report = {"command": _command(arguments, runs), "runs": runs, "versions": machine()["versions"]}
        results.write(arguments.output, "time_to_skill", report, table(report))


def _command(arguments: argparse.Namespace, runs: Sequence[dict[str, Any]]) -> str:
    """Return the single command that makes all of ``runs``, which several calls may have made."""
    options = {name: getattr(arguments, name.replace("-", "_")) for name in ("minutes", "every", "robots-per-command")}
    parts = [f"--{name} {value:g}" for name, value in options.items()]
    parts.append(f"--seeds {' '.join(str(run['seed']) for run in runs)}")
    parts += [f"--set {text}" for text in arguments.overrides]
    return " ".join(["python -m benchmarks.time_to_skill", *parts])


if __name__ == "__main__":
    sys.exit(main())

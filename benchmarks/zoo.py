"""Policies of all pairs of robot and transporter: trained, measured and packed as bundles, by one command.

``python -m benchmarks.zoo`` does what is missing of each pair, one step after the other: it can be stopped and started
again at any time. The steps are the training by one recipe, the scorecard, the range of commands that was mastered, the
robustness sweep, the other robots and transporters of the size class, and the bundle with the check of its actions. The
report is of all pairs that are packed. Two commands at once, each with half of the pairs and a core of its own
(``taskset -c 0 python -m benchmarks.zoo --pairs ...``), are done sooner than one with both cores.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import results, scorecard
from torchrl_atr._files import say
from torchrl_atr.deploy.card import figures, read_report
from torchrl_atr.deploy.manifest import MANIFEST, POLICY, BundleError, is_bundle, read_manifest
from torchrl_atr.envs import ROBOTS
from torchrl_atr.envs.models import TRANSPORTER_DESIGNS
from torchrl_atr.evaluation.intervals import share_text, wilson
from torchrl_atr.runs.files import ORIGIN
from torchrl_atr.runs.provenance import cores, machine
from torchrl_atr.training import TrainConfig, make_config

PAIRS = tuple(f"{robot}:{transporter}" for robot in ROBOTS.names() for transporter in TRANSPORTER_DESIGNS)
AREA = "area-5x1"
"""Row of the scorecard from which the mastered range of commands is taken."""
_QUICK_RIDE = ("--robots", "2", "--seconds", "2.1", "--command-seconds", "2.1")
_QUICK_GRID = ("--max-speed", "1", "--max-yaw-rate", "0", "--speed-step", "1", "--robots-per-command", "1")
QUICK: dict[str, Any] = {
    "env.num_envs": 4,
    "ppo.rollout_steps": 4,
    "ppo.minibatches": 1,
    "compute.num_threads": 1,
    "compute.compiled": False,
    "total_frames": 32,
}
"""Settings of a training that shows that everything works."""
FREE = ("compute", "max_minutes")
"""Settings that are not of the recipe: a run that is there may have been trained on another number of cores."""
FIGURES = (
    "n",
    "survival",
    "survival_interval",
    "settled_speed_error",
    "settled_yaw_error",
    "commands_mastered_of_envelope",
)
"""Figures of a scorecard that the report holds."""
QUICK_ROWS: Mapping[str, Sequence[str]] = {AREA: _QUICK_GRID, "endurance": _QUICK_RIDE}


@dataclass(frozen=True)
class Pair:
    """Pair of robot and transporter, and where its files are.

    Attributes:
        name: ``ROBOT-TRANSPORTER``.
        config: of its training.
        run: folder of the run.
        bundle: folder of the bundle.
        seed: of the measurements.
        quick: whether sizes are tiny.
    """

    name: str
    config: TrainConfig
    run: Path
    bundle: Path
    seed: int
    quick: bool


class Step(NamedTuple):
    """Step of the work on a pair.

    Attributes:
        name: of it, in messages.
        done: whether there is nothing left to do.
        work: does it; a step that was stopped goes on where it was.
    """

    name: str
    done: Callable[[Pair], bool]
    work: Callable[[Pair], None]


def _train(pair: Pair) -> None:
    results.train(pair.config, pair.run)


def _measure(pair: Pair) -> None:
    rows, more = (tuple(QUICK_ROWS), QUICK_ROWS) if pair.quick else (tuple(scorecard.EVALUATIONS), None)
    scorecard.measure(pair.run, pair.seed, rows, more)


def _record_range(pair: Pair) -> None:
    """Record the mastered commands, to which the bundle clips; without any it clips to those that were trained."""
    from torchrl_atr.evaluation import load_tracking, mastered_range

    limits = mastered_range(load_tracking(pair.run / AREA / "tracking.npz"))
    if limits is not None and limits.max_speed > 0:
        limits.save(pair.run)


def _sweep(pair: Pair, protocol: str) -> None:
    parameters = ["--parameters", "payload"] if protocol == "robustness" else []
    results.call(
        "evaluate", pair.run, "--protocol", protocol, "--seed", pair.seed, *([*_QUICK_RIDE, *parameters] * pair.quick)
    )


def _pack(pair: Pair) -> None:
    results.call("export", pair.run, "--output", pair.bundle)
    results.call("verify", pair.bundle)


def _has(pair: Pair, file: str) -> bool:
    return (pair.run / file).is_file()


def _packed(pair: Pair) -> bool:
    """Return whether the bundle is whole, and of the run and its measurements as they are."""
    if not is_bundle(pair.bundle):
        return False
    try:
        manifest = read_manifest(pair.bundle)
    except BundleError:  # changed, or of an earlier version
        return False
    packed = (pair.bundle / MANIFEST).stat().st_mtime
    swept = [file.stat().st_mtime for name in (_ROBUST, _OTHERS) if (file := pair.run / name).is_file()]
    same = manifest["training"] == read_report(pair.run / ORIGIN) and manifest["figures"] == figures(pair.run)
    return same and packed >= max(swept, default=0.0)


_CARD, _ROBUST, _OTHERS = "scorecard.json", "robustness/metrics.json", "compatibility/metrics.json"
STEPS: tuple[Step, ...] = (
    Step("training", partial(_has, file=_CARD), _train),
    Step("scorecard", partial(_has, file=_CARD), _measure),
    Step("range of commands", partial(_has, file=_ROBUST), _record_range),
    Step("robustness", partial(_has, file=_ROBUST), partial(_sweep, protocol="robustness")),
    Step("compatibility", partial(_has, file=_OTHERS), partial(_sweep, protocol="compatibility")),
    Step("bundle", _packed, _pack),
)
"""Steps of the work on a pair, in order."""


def make_pair(name: str, arguments: argparse.Namespace) -> Pair:
    """Return the pair ``ROBOT:TRANSPORTER`` with the recipe of all, for the options of the command line."""
    robot, transporter = name.split(":")
    given = {"task.robot": robot, "task.transporter": transporter, "seed": arguments.seed}
    recipe = QUICK if arguments.quick else {"compute.compiled": True, "max_minutes": arguments.max_minutes}
    folder = f"{robot}-{transporter}"
    return Pair(
        folder,
        make_config({**given, **recipe}),
        arguments.runs / folder,
        arguments.policies / folder,
        arguments.seed + 90210,
        arguments.quick,
    )


def work_on(pair: Pair) -> None:
    """Do what is left to do for a pair.

    Raises:
        KeyboardInterrupt: if it was stopped. UserError: if a step failed; names it.
    """
    for step in STEPS:
        if not step.done(pair):
            say(f"{pair.name}: {step.name}")
            step.work(pair)


def report(pairs: Sequence[Pair], command: str) -> dict[str, Any]:
    """Return the report of the pairs that are packed: figures of their scorecards, and facts of their bundles."""
    rows = {}
    for pair in pairs:
        if _packed(pair):
            manifest, card = read_manifest(pair.bundle), read_report(pair.run / _CARD)
            rows[pair.name] = {
                "training": manifest["training"],
                "command_limits": manifest["command"]["limits"],
                "parity": manifest["parity"],
                "bytes": sum(file.stat().st_size for file in pair.bundle.rglob("*") if file.is_file()),
                "onnx_bytes": (pair.bundle / POLICY).stat().st_size,
                "evaluations": {
                    row: {name: metrics.get(name) for name in FIGURES} for row, metrics in card["evaluations"].items()
                },
            }
    return {"command": command, **machine(), "pairs": rows}


def page(found: Mapping[str, Any]) -> str:
    """Return the report as Markdown."""
    lines = [
        "# Policies of every robot on every transporter",
        "",
        f"`{found['command']}`. One recipe for all; every row is a deployed policy with the sensors that it was "
        "trained with. Up: share of robots that have not fallen, with its 95 % interval. 60 s: new commands in "
        "±2 m/s × ±1 rad/s every 5 s, pushes every 3 s. Mastered: of the commands in ±5 m/s × ±1 rad/s that can be "
        "followed at all, those at which most robots stay up and settle within 0.5 m/s and 0.3 rad/s. Actions: largest "
        "difference of ONNX Runtime from torch, in units of the action scale.",
        "",
        "| policy | minutes | robot steps | up, 60 s | speed error, m/s | yaw error, rad/s | up, 10 s, ±5 × ±1 | "
        "mastered | commands clipped to | actions | MB |",
        f"| {' | '.join(['---'] * 11)} |",
    ]
    for name, row in found["pairs"].items():
        lasting, area = (row["evaluations"].get(key, {}) for key in ("endurance", AREA))
        limits = row["command_limits"]
        mastered = area.get("commands_mastered_of_envelope")
        cells = [
            name,
            f"{row['training']['minutes']:.0f}",
            f"{row['training']['frames']:,}",
            _up(lasting),
            *(_number(lasting.get(f"settled_{error}_error")) for error in ("speed", "yaw")),
            _up(area),
            "-" if mastered is None else f"{mastered:.0%}",
            f"±{limits['max_speed']:g} m/s, ±{limits['max_yaw_rate']:g} rad/s",
            f"{row['parity']['error']:.0e}",
            f"{row['bytes'] / 1e6:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    machines = sorted({cores(row["training"]["hardware"]) for row in found["pairs"].values()})
    return "\n".join([*lines, "", f"Trained on {'; '.join(machines) or '-'}.", ""])


def _up(metrics: Mapping[str, Any]) -> str:
    if not metrics:
        return "-"
    share, n = metrics["survival"], metrics["n"]
    return share_text(share, metrics.get("survival_interval") or wilson(round(share * n), n))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _all(arguments: argparse.Namespace) -> None:
    pairs = [make_pair(name, arguments) for name in arguments.pairs]
    for pair in pairs:
        results.refuse_other_settings(pair.config, pair.run, FREE)
    words = [f"--seed {arguments.seed}", *([] if arguments.quick else [f"--max-minutes {arguments.max_minutes:g}"])]
    command = " ".join(["python -m benchmarks.zoo", *words, *["--quick"] * arguments.quick])
    for pair in pairs:
        work_on(pair)
        every = [make_pair(name, arguments) for name in PAIRS]
        found = report(every, command)
        results.write(arguments.output, "zoo", found, page(found))
    say(f"{page(found)}\nreport in {arguments.output}")


def main(argv: Sequence[str] | None = None) -> int:
    """Train, measure and pack; bad input ends with one message and exit code 2."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.zoo", description=__doc__)
    parser.add_argument("--pairs", nargs="+", choices=PAIRS, default=PAIRS, metavar="ROBOT:TRANSPORTER")
    parser.add_argument("--max-minutes", type=float, default=90.0, help="of training for each pair; default: 90")
    parser.add_argument("--runs", type=Path, default=Path("runs/zoo"), metavar="FOLDER", help="to continue")
    parser.add_argument("--policies", type=Path, default=Path("torchrl_atr/policies"), metavar="FOLDER")
    parser.add_argument("--output", type=Path, default=Path("results/zoo"), metavar="FOLDER", help="of the report")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="tiny sizes: shows that it works, measures nothing")
    arguments = parser.parse_args(argv)
    if arguments.quick and arguments.policies == parser.get_default("policies"):
        parser.error("--quick packs policies that were hardly trained; give another folder with --policies")
    return results.exit_code("zoo", partial(_all, arguments))


if __name__ == "__main__":
    sys.exit(main())

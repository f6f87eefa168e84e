"""Scorecard of a trained policy, by one command: ``python -m benchmarks.scorecard RUN``.

Each row is one ``torchrl-atr evaluate``, whose report is in a folder of RUN. Commands are not clipped to the run's
range, which is of what the policy masters. Stopped and called again, it continues with the rows that are missing, or of
another training or seed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import results
from torchrl_atr._errors import UserError
from torchrl_atr._files import say
from torchrl_atr.deploy.card import read_report
from torchrl_atr.deploy.manifest import is_bundle
from torchrl_atr.evaluation.intervals import wilson
from torchrl_atr.runs.files import ORIGIN
from torchrl_atr.runs.provenance import cores, machine

STILL = ("--max-speed", "0", "--max-yaw-rate", "0", "--no-pushes")
NARROW = ("--max-speed", "5", "--max-yaw-rate", "1", "--speed-step", "1", "--yaw-rate-step", "0.25")
WIDE = ("--max-speed", "15", "--max-yaw-rate", "2", "--speed-step", "3", "--yaw-rate-step", "0.5")
TEST = ("--randomization", "test")
LASTING = ("--protocol", "endurance")
EVALUATIONS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "tracking": ("10 s, ±2 m/s × ±1 rad/s", ()),
    "tracking-test": ("the same, test range", TEST),
    "area-5x1": ("10 s, ±5 m/s × ±1 rad/s", NARROW),
    "area-5x1-test": ("the same, test range", (*NARROW, *TEST)),
    "area-15x2": ("10 s, ±15 m/s × ±2 rad/s", WIDE),
    "area-15x2-test": ("the same, test range", (*WIDE, *TEST)),
    "endurance": ("60 s, pushes, commands change every 5 s", (*LASTING, "--robots", "400")),
    "endurance-test": ("the same, test range", (*LASTING, "--robots", "400", *TEST)),
    "endurance-300": ("300 s of the same", (*LASTING, "--robots", "200", "--seconds", "300")),
    "standing-300": ("300 s standing still, no pushes", (*LASTING, "--robots", "200", "--seconds", "300", *STILL)),
}
"""Protocol and options of ``torchrl-atr evaluate``, by the folder of the report."""


def evaluate(
    run: Path, seed: int, rows: Sequence[str], more: Mapping[str, Sequence[str]] | None = None
) -> dict[str, dict[str, Any]]:
    """Run the evaluations of ``rows`` that are missing, or of another training or seed; return the metrics of each.

    Args:
        run: folder of a trained run.
        seed: of the evaluations.
        rows: names in :data:`EVALUATIONS`.
        more: further options of the rows that it names.

    Raises:
        UserError: if an evaluation failed, or ``run`` is a policy bundle.
    """
    if is_bundle(run):
        raise UserError(f"{run} is a policy bundle, whose files are sealed; give the run that it was exported from")
    metrics, trained = {}, read_report(run / ORIGIN)
    for name in rows:
        folder, options = run / name, (*EVALUATIONS[name][1], *(more or {}).get(name, ()))
        found = read_report(folder / "metrics.json")
        if found is None or found["run"] != trained or found["evaluation"]["seed"] != seed:
            asked = ("--seed", seed, "--output", folder, "--command-range", "ignore")
            results.call("evaluate", run, *asked, *options)
        metrics[name] = read_report(folder / "metrics.json")
    return metrics


def row(name: str, metrics: Mapping[str, Any]) -> str:
    """Return a row of the table: survival with its interval, settled errors, share of commands mastered."""
    up, n = metrics["survival"], metrics["n"]
    low, high = metrics.get("survival_interval") or wilson(round(up * n), n)
    errors = [metrics["settled_speed_error"], metrics["settled_yaw_error"]]
    mastered = metrics.get("commands_mastered")
    cells = [EVALUATIONS[name][0], str(n), f"{up:.1%} [{low:.1%}, {high:.1%}]"]
    cells += ["-" if error is None else f"{error:.3f}" for error in errors]
    cells.append("-" if mastered is None else f"{mastered:.0%}")
    return f"| {' | '.join(cells)} |"


def page(report: Mapping[str, Any]) -> str:
    """Return the report as Markdown."""
    origin = report["run"]
    lines = [
        f"# {report['robot']} on {report['transporter']}",
        "",
        f"Trained by `{origin['command']}`: {origin['frames']:,} robot steps from scratch in "
        f"{origin['minutes']:.0f} minutes on {cores(origin['hardware'])}, seed {origin['seed']}.",
        "",
        f"Measured by `{report['command']}`. Deployed: the policy reads what a robot senses, with the sensors that it "
        "was trained with; commands are not clipped; training range unless a row says otherwise. Intervals are of "
        "95 %; errors are means over robots that are up, after settling; mastered commands are those at which most "
        "robots stay up and settle within 0.5 m/s and 0.3 rad/s.",
        "",
        "| protocol | robots | up at the end | speed error, m/s | yaw error, rad/s | commands mastered |",
        "| --- | --- | --- | --- | --- | --- |",
        *(row(name, metrics) for name, metrics in report["evaluations"].items()),
        "",
    ]
    lasting = report["evaluations"].get("endurance")
    if lasting is None:  # not among the rows that were asked for
        return "\n".join(lines)
    drift, (low, high) = lasting["estimate_drift"], lasting["estimate_drift_interval"] or (None, None)
    if drift is None or low is None:  # of one robot at most
        return "\n".join(lines)
    lines += [
        f"The error of the estimated platform speed in the last 10 s of a minute is {drift:.2f} times "
        f"[{low:.2f}, {high:.2f}] that in the first 10 s.",
        "",
    ]
    return "\n".join(lines)


def measure(
    run: Path, seed: int, rows: Sequence[str], more: Mapping[str, Sequence[str]] | None = None
) -> dict[str, Any]:
    """Evaluate a run, see :func:`evaluate`; write ``scorecard.json`` and ``README.md`` into it; return the report."""
    metrics = evaluate(run, seed, [name for name in EVALUATIONS if name in rows], more)
    origin = next(iter(metrics.values()))
    some = "" if len(metrics) == len(EVALUATIONS) else f" --rows {' '.join(metrics)}"
    report = {
        "command": f"python -m benchmarks.scorecard {run} --seed {seed}{some}",
        "robot": origin["evaluation"]["robot"],
        "transporter": origin["evaluation"]["transporter"],
        "run": origin["run"],
        **machine(),
        "evaluations": {name: _short(each) for name, each in metrics.items()},
    }
    results.write(run, "scorecard", report, page(report))
    return report


def _short(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return the single numbers and intervals of an evaluation; the rest is in its own folder."""
    return {
        name: value
        for name, value in metrics.items()
        if value is None or isinstance(value, int | float | str) or name.endswith("_interval")
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Evaluate a run by every protocol; write ``scorecard.json`` and ``README.md`` into its folder."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scorecard", description=__doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a trained run")
    parser.add_argument("--seed", type=int, default=90210)
    parser.add_argument("--rows", nargs="+", choices=tuple(EVALUATIONS), default=tuple(EVALUATIONS), metavar="ROW")
    arguments = parser.parse_args(argv)
    return results.exit_code("scorecard", partial(_measure, arguments))


def _measure(arguments: argparse.Namespace) -> None:
    say(page(measure(arguments.run, arguments.seed, arguments.rows)))


if __name__ == "__main__":
    sys.exit(main())

"""Lines that ``torchrl-atr train`` ends with: what the run came to, where its time went, what to do with it."""

from __future__ import annotations

import csv
import shlex
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean

from torchrl_atr._text import number

_LATE = 100
"""Iterations at the end of a run that the figures are means of."""
_FIGURES = {
    "{} falls a robot and minute": ("falls_per_minute",),
    "{} m/s and {} rad/s off the command": ("speed_error", "yaw_error"),
    "{} control steps an episode": ("episode_length",),
}
"""Columns of ``progress.csv`` by the phrase that their means are put into; one that a log lacks leaves it out."""
_COLUMNS = tuple(column for columns in _FIGURES.values() for column in columns)


def run_figures(progress_csv: Path) -> Iterator[str]:
    """Yield lines on the end of a run and on its time, from its log; none without a log.

    The figures are of training: with exploration, the training's pushes and the training's commands.
    """
    rows = _rows(progress_csv)
    seconds = 60.0 * rows[-1].get("minutes", 0.0) if rows else 0.0
    if not seconds:
        return
    late = {name: [row[name] for row in rows[-_LATE:] if name in row] for name in _COLUMNS}
    means = {name: number(fmean(values), 8, 3).strip() for name, values in late.items() if values}
    shown = [phrase.format(*map(means.get, names)) for phrase, names in _FIGURES.items() if means.keys() >= {*names}]
    if shown:
        yield f"last {min(_LATE, len(rows))} iterations, exploring: {', '.join(shown)}"
    spent = {name: sum(row.get(f"{name}_seconds", 0.0) for row in rows) for name in ("collect", "learn")}
    share = {name: min(1.0, value / seconds) for name, value in spent.items()}
    rest = max(0.0, 1.0 - sum(share.values()))
    yield (
        f"{rows[-1]['frames'] / seconds:,.0f} robot steps a second: {share['collect']:.0%} of the time to collect, "
        f"{share['learn']:.0%} to learn, {rest:.0%} for logs, checkpoints and start"
    )


def next_commands(run: Path, task: str = "riding", teacher: bool = False) -> list[str]:
    """Return commands for a run that ended, and what each is for.

    Args:
        run: its folder.
        task: its name; policies of riding and walking can be exported.
        teacher: whether there is only a policy on privileged information, which is not deployed.
    """
    folder, truth = shlex.quote(str(run)), " --act-source privileged" if teacher else ""
    commands = [
        (f"torchrl-atr evaluate {folder}{truth}", "how well it tracks commands"),
        (f"torchrl-atr evaluate {folder} --protocol endurance{truth}", "how long it lasts"),
        *([] if teacher else [(f"torchrl-atr view {folder}", "see it and steer it in the browser")]),
        (f"torchrl-atr plot {folder} --output {folder}/figures", "learning curves and evaluations as figures"),
    ]
    if task in ("riding", "walking") and not teacher:
        commands.append((f"torchrl-atr export {folder} --output my-policy", "a policy that runs without torch"))
    width = max(len(command) for command, _ in commands)
    return ["next:", *(f"  {command:{width}}  # {purpose}" for command, purpose in commands)]


def _rows(path: Path) -> list[dict[str, float]]:
    """Return what the lines need of each row of a log, as numbers; cells that are empty are left out."""
    if not path.is_file():
        return []
    wanted = (*_COLUMNS, "frames", "minutes", "collect_seconds", "learn_seconds")
    with path.open(newline="", encoding="utf-8") as file:
        return [{name: float(row[name]) for name in wanted if row.get(name)} for row in csv.DictReader(file)]

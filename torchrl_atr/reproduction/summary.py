"""Page on all claims of the paper, from the reports that there are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic
from torchrl_atr.reproduction.report import FAILS, HOLDS, UNKNOWN, claim_table, made_by

NAMES = ("figure4", "table5", "figure6", "figure5", "figure7")
"""Reports in the order of the page."""


def summary(root: str | Path) -> Path:
    """Write ``README.md`` on the claims of the reports in ``root``; return it.

    Args:
        root: holds a folder for each report, such as ``figure4`` with ``figure4.json``.

    Raises:
        InputError: if there is no report.
    """
    root = Path(root)
    found = {name: file for name in NAMES if (file := root / name / f"{name}.json").is_file()}
    if not found:
        raise InputError(f"{root} holds no report, such as figure4/figure4.json; make one first")
    reports = {name: json.loads(file.read_text(encoding="utf-8")) for name, file in found.items()}
    path = root / "README.md"
    with atomic(path) as file:
        file.write_text(page(reports), encoding="utf-8")
    return path


def page(reports: dict[str, Any]) -> str:
    """Return the page as Markdown, given the content of the JSON files by name."""
    verdicts = [claim["verdict"] for report in reports.values() for claim in report["claims"]]
    counts = ", ".join(f"{verdicts.count(each)} {each}" for each in (HOLDS, FAILS, UNKNOWN))
    parts = [
        "# The paper's claims, tested here",
        f"{len(verdicts)} tests: {counts}. A claim holds if the 95 % interval of its figure is on its side, does not "
        "hold here if it is on the other, and else cannot be told. The paper trains for 75,000 episodes of 10 s in "
        "4,096 environments; the policies here, below, are of fewer robot steps. Made by `torchrl-atr reproduce "
        "summary` from the reports' JSON files; docs/reproduce.md explains the tests.",
    ]
    missing = [name for name in NAMES if name not in reports]
    if missing:
        parts.append(f"Not made: {', '.join(missing)}.")
    for name, report in reports.items():
        parts += [f"## [{report['title']}]({name}/README.md)", made_by(report["made"])]
        parts.append(claim_table(report["claims"]) if report["claims"] else "No claim was tested.")
    return "\n\n".join(parts) + "\n"

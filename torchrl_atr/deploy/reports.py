"""Log and evaluations of a run that go with its bundle, for ``torchrl-atr plot``; short, for a bundle has 2 MB."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl_atr.deploy.card import read_report
from torchrl_atr.evaluation.report import load_tracking, save_tracking
from torchrl_atr.evaluation.set_figures import CURVES
from torchrl_atr.runs.files import LOG, copy_log

PROTOCOLS = ("endurance", "tracking")
"""Protocols whose evaluations are copied: folders of the run."""
_ROWS = 200
_TRIALS = "tracking.npz"


def copy_reports(run: Path, folder: Path, trained: Mapping[str, Any]) -> None:
    """Copy a run's log and what it was measured by, where there is any; evaluations of another training are left out.

    Args:
        run: its folder.
        folder: of the bundle.
        trained: provenance of the checkpoint that is exported.

    Raises:
        OSError: if a file cannot be read or written.
    """
    if (run / LOG).is_file():
        copy_log(run, folder, _ROWS, ("frames", *CURVES))
    for protocol in PROTOCOLS:
        for home in (run / protocol, run):  # `evaluate` writes what it measures by default into the run itself
            report = read_report(home / "metrics.json")
            if report and report.get("run") == trained and (home != run or report.get("protocol") == protocol):
                _copy_report(report, home, folder / protocol)
                break


def _copy_report(report: Mapping[str, Any], home: Path, folder: Path) -> None:
    folder.mkdir()
    (folder / "metrics.json").write_text(json.dumps(report, separators=(",", ":")), encoding="utf-8")
    if (trials := home / _TRIALS).is_file():  # for the heat maps, which need no estimates
        save_tracking(dataclasses.replace(load_tracking(trials), estimators=None), folder / _TRIALS)

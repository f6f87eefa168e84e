"""Claims of Figure 4 on trials whose errors are known, and its report of an untrained policy."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from torchrl_atr.evaluation import TrackingResult
from torchrl_atr.reproduction import figure4 as module
from torchrl_atr.reproduction.figure4 import figure4
from torchrl_atr.reproduction.paper import PAIRS
from torchrl_atr.reproduction.report import FAILS, HOLDS, UNKNOWN
from torchrl_atr.reproduction.table5 import table5
from torchrl_atr.reproduction.tracking import Grid, combined_error, measure, tracking_figures

GRID = Grid(speed_step=15.0, yaw_rate_step=2.0, robots=1, seconds=0.08, settle=0.04)
V, W = np.array([-15.0, 0.0, 15.0]), np.array([-2.0, 0.0, 2.0])


def tracked(error, fallen=False):
    """A result whose speed error is ``error`` of |c_v|, and nothing else is wrong."""
    values = np.broadcast_to(error(np.abs(V))[:, None, None], (3, 3, 4)).copy()
    zero, never = np.zeros((3, 3, 4)), np.full((3, 3, 4), np.nan)
    fall = np.full((3, 3, 4), 1.0) if fallen else never
    return TrackingResult(V, W, values, zero, values, zero, zero, zero, fall, 10.0, 5.0)


def verdicts(results):
    claims = [
        *module._coverage(results),
        *module._fast(results),
        module._light(results),
        *module._two_boards(results),
        *module._shared(results),
    ]
    return [claim.verdict for claim in claims]


def test_claims_follow_from_the_errors():
    good, worse = tracked(lambda v: 0.02 * v), tracked(lambda v: 0.04 * v)
    pairs = {"a1-single_board": worse, "go1-single_board": worse, "spot-single_board": good, "a1-two_board": good}
    # every pair covers more than a still board, is worse when fast; G1 is worse; a1's two boards are not behind
    assert verdicts(pairs) == [HOLDS] * 4 + [HOLDS] * 4 + [HOLDS, FAILS, HOLDS]


def test_what_is_missing_cannot_be_told():
    assert verdicts({"a1-single_board": tracked(lambda v: v)})[2:] == [UNKNOWN] * 3


def test_a_fall_costs_at_least_the_error_of_a_board_that_never_moves():
    result = tracked(lambda v: 0.0 * v, fallen=True)
    assert combined_error(result).max() == pytest.approx(np.hypot(15.0, 2.0))
    assert tracking_figures(result)["area"] == 0.0
    assert tracking_figures(replace(result, fall_time=np.full((3, 3, 4), np.nan)))["area"] == 1.0


def test_the_report_of_one_pair_names_those_that_are_missing_and_measures_once(job, tmp_path, monkeypatch):
    page = figure4(job, tmp_path, compatibility=True, grid=GRID).read_text()
    assert f"Missing, as no policy was given: {', '.join(pair for pair in PAIRS if pair != 'a1-single_board')}." in page
    assert "a1-single_board, ridden by go1" in page
    values = json.loads((tmp_path / "figure4.json").read_text())
    assert values["pairs"]["a1-single_board"]["n"] == 9
    assert len(values["missing"]) == 7
    assert {"heatmaps.png", "command_area.png", "README.md"} <= {file.name for file in tmp_path.iterdir()}
    # Table V measures the same trials with the training's sensors: only the other set is new
    before = len(list(job.parts.folder.iterdir()))
    page = table5(job, tmp_path, grid=GRID).read_text()
    assert len(list(job.parts.folder.iterdir())) == before + 1
    assert "| component | paper | shipped, ideal | shipped, realistic |" in page
    assert "| contact FR | 0.0170 ± 0.0085 | " in page
    errors = measure(job, job.policies[0], GRID, "ideal").estimators
    rows = json.loads((tmp_path / "table5.json").read_text())["pairs"]["a1-single_board"]["shipped, ideal"]
    assert rows["body_velocity[0]"]["mean"] == pytest.approx(errors.moments()[1][4][1])
    low, high = rows["body_velocity[0]"]["interval"]
    assert low <= rows["body_velocity[0]"]["mean"] <= high

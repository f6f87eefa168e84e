"""Figure 5: an untrained policy on a small map, and paired differences of trips that are known."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.evaluation.energy import CostOfTransport
from torchrl_atr.navigation import Path, TripsResult
from torchrl_atr.navigation.report import load_trips, save_trips
from torchrl_atr.reproduction import figure5 as module
from torchrl_atr.reproduction import trip_groups
from torchrl_atr.reproduction.figure5 import figure5
from torchrl_atr.reproduction.trip_groups import Method, group_of, speed_text
from torchrl_atr.training import make_config

YARD = "outline = [[0, 0], [40, 0], [40, 40], [0, 40]]\n"


def trips(outcome, cost):
    n = len(outcome)
    ones = np.ones(n)
    traces = [np.zeros((2, 6))] * n
    return TripsResult(
        np.array(outcome),
        *[ones] * 7,
        CostOfTransport(np.array(cost) / 12, np.array(cost), 2.0 * np.array(cost)),
        traces,
    )


def method(name, rides):
    return Method(SimpleNamespace(name=name, rides=rides), "a1", "G1", (1.0, 0.5))


def test_costs_are_compared_on_the_paths_that_both_completed():
    results = {
        ("yard", "a1-single_board"): trips(["goal", "goal", "goal", "fell"], [0.5, 0.6, 0.7, 9.0]),
        ("yard", "a1-walking"): trips(["goal", "goal", "timeout", "goal"], [1.5, 1.6, 9.0, 9.0]),
    }
    (row,) = module._differences(results, [method("a1-single_board", True), method("a1-walking", False)])
    assert row["paths"] == 2
    assert row["joints"]["difference"] == pytest.approx(1.0)
    assert row["joints"]["interval"] == pytest.approx([1.0, 1.0])
    assert row["system"]["difference"] == pytest.approx(2.0)
    assert module._claim(row).verdict == "holds"
    assert module._claim(None).verdict == "cannot be told"


def test_trips_are_written_and_read_back(tmp_path):
    before = trips(["goal", "fell"], [0.5, 0.6])
    save_trips(before, [], tmp_path / "trips.npz")
    after = load_trips(tmp_path / "trips.npz")
    assert after.outcome.tolist() == ["goal", "fell"]
    np.testing.assert_array_equal(after.cost.system, before.cost.system)
    assert after.traces[1].shape == (2, 6)


def test_the_report_of_a_policy_that_does_not_arrive(job, tmp_path, monkeypatch):
    straight = Path.through(np.linspace([5.0, 5.0], [8.0, 5.0], 4))
    monkeypatch.setattr(module, "plan_all", lambda starts, *_, **__: [straight] * len(starts))
    monkeypatch.setattr("torchrl_atr.navigation.trips.PATIENCE", 0.05)
    (tmp_path / "yard.toml").write_text(YARD)
    page = figure5(job, tmp_path, maps=[str(tmp_path / "yard.toml")], starts=1).read_text()
    assert "No walking policy was given" in page
    assert "not measured" in page  # the cost of transport of a trip that did not end at the goal
    (row,) = json.loads((tmp_path / "figure5.json").read_text())["trips"]
    assert (row["trips"], row["success"]) == (1, 0.0)
    drawn = {"cost_of_transport.png", "yard-a1-single_board.png", "yard-a1-single_board.gif"}
    assert drawn <= {file.name for file in tmp_path.iterdir()}


def test_trips_are_as_fast_as_all_of_a_group_take(monkeypatch):
    monkeypatch.setattr(trip_groups, "SPEEDS", {"G2": 3.0})
    slow, fast = (
        method(name, True)._replace(group="G2", fastest=most) for name, most in (("slow", 2.2), ("fast", 5.0))
    )
    fast = fast._replace(footprint=(0.8, 0.9))
    group = group_of("G2", [slow, fast, method("other", True)])
    assert (group.speed, group.footprint, group.slowest) == (2.2, (1.0, 0.9), "slow")
    assert speed_text(group) == "2.2 m/s in G2 (the paper's 3 are more than slow takes)"
    assert speed_text(group_of("G2", [fast])) == "3 m/s in G2"


def test_a_policy_that_hardly_moves_is_refused_before_the_simulation(job, tmp_path, monkeypatch):
    monkeypatch.setattr(trip_groups, "SLOWEST", 50.0)
    with pytest.raises(InputError, match=r"takes commands up to 2\.2 m/s, and trips are at 50 m/s or more"):
        figure5(job, tmp_path, maps=["open"])


def test_policies_of_the_other_task_are_refused(job, tmp_path):
    with pytest.raises(InputError, match=r"--walking .*: it is a1-single_board; give it with --policies"):
        figure5(job, tmp_path, walking=job.policies, maps=["open"])
    walker = replace(job.policies[0], name="a1-walking", config=make_config({"task.name": "walking"}))
    with pytest.raises(InputError, match=r"--policies .*: it is a1-walking; give it with --walking"):
        figure5(replace(job, policies=[walker]), tmp_path, maps=["open"])


def test_without_a_policy_there_is_nothing_to_do(job, tmp_path):
    job.policies = []
    with pytest.raises(InputError, match="needs policies that ride"):
        figure5(job, tmp_path)

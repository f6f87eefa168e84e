"""Training until a bar is met, on a clock of which an iteration takes half a second."""

from __future__ import annotations

import itertools
import json
from functools import partial

import pytest

from benchmarks import time_to_skill
from torchrl_atr.evaluation import evaluate_tracking

TINY = ["--minutes", "0.05", "--every", "0.02", "--seeds", "0", "--set", "env.num_envs=8", "--robots-per-command", "1"]


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """A grid of four commands, trials of a second, and a clock that a loaded machine does not slow down."""
    monkeypatch.setattr(time_to_skill, "evaluate_tracking", partial(evaluate_tracking, seconds=1.0, settle=0.5))
    monkeypatch.setattr(time_to_skill, "GRID", (2.0, 1.0, 2.0, 1.0))
    monkeypatch.setattr("torchrl_atr.training.trainer.time.monotonic", itertools.count(step=0.1).__next__)


def arguments(folder):
    return [*TINY, "--output", str(folder), "--runs", str(folder / "runs")]


def test_nobody_is_skilled_after_three_seconds_and_other_settings_are_refused(tmp_path, capsys):
    assert time_to_skill.main(arguments(tmp_path)) == 0
    (run,) = json.loads((tmp_path / "time_to_skill.json").read_text())["runs"]
    evaluations = run["evaluations"]
    assert len(evaluations) >= 2
    assert evaluations[-1]["minutes"] >= 0.05
    assert evaluations[0]["minutes"] < 0.05
    assert run["hardware"]["cpus"] >= 1
    assert "0 of 1 seeds met it" in (tmp_path / "README.md").read_text()
    assert time_to_skill.main([*arguments(tmp_path), "--set", "ppo.gamma=0.9"]) == 2
    assert "was trained with ppo.gamma=0.995 instead of 0.9; give another folder" in capsys.readouterr().err


def test_a_run_that_meets_the_bar_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(time_to_skill, "BAR", {"survival": (0.0, 1.0)})
    assert time_to_skill.main(arguments(tmp_path)) == 0
    (run,) = json.loads((tmp_path / "time_to_skill.json").read_text())["runs"]
    assert len(run["evaluations"]) == 1
    assert "1 of 1 seeds met it" in (tmp_path / "README.md").read_text()


def test_the_median_seed_counts_those_that_never_met_the_bar():
    def run(minutes, up):
        figures = {"survival": up, "settled_speed_error": 0.1, "settled_yaw_error": 0.1}
        return {
            "seed": 0,
            "hardware": {},
            "evaluations": [{"minutes": minutes, "frames": int(minutes * 10), **figures}],
        }

    assert time_to_skill._median([run(30, 1.0), run(50, 0.9), run(40, 1.0)]) == "Median: 40.0 minutes, 400 robot steps."
    assert time_to_skill._median([run(30, 1.0), run(50, 0.9), run(50, 0.9)]) == "The median seed did not."


def test_a_run_that_was_stopped_goes_on(tmp_path, monkeypatch):
    evaluate, stops = time_to_skill.evaluate, iter([None, KeyboardInterrupt])

    def stopping(*given):
        if stop := next(stops, None):
            raise stop
        return evaluate(*given)

    monkeypatch.setattr(time_to_skill, "evaluate", stopping)
    assert time_to_skill.main(arguments(tmp_path)) == 130
    first = json.loads((tmp_path / "runs" / "0" / "evaluations.json").read_text())
    assert len(first) == 1
    assert time_to_skill.main(arguments(tmp_path)) == 0
    (run,) = json.loads((tmp_path / "time_to_skill.json").read_text())["runs"]
    assert run["evaluations"][0] == first[0]
    assert len(run["evaluations"]) > 1
    again = (tmp_path / "runs" / "0" / "progress.csv").read_bytes()
    assert time_to_skill.main(arguments(tmp_path)) == 0  # nothing is left to do
    assert (tmp_path / "runs" / "0" / "progress.csv").read_bytes() == again


def test_a_wrong_setting_is_refused(tmp_path, capsys):
    assert time_to_skill.main([*arguments(tmp_path / "other"), "--set", "ppo.gama=0.9"]) == 2
    assert "did you mean 'ppo.gamma'" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()

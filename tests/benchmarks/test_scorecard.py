"""A row of a policy's card says what was measured, with its interval."""

from __future__ import annotations

import json

import pytest

from benchmarks import results, scorecard
from torchrl_atr._errors import UserError
from torchrl_atr._interrupt import Stopped

TRAINED = {"command": "torchrl-atr train", "frames": 1, "minutes": 1.0, "seed": 0}
TRAINED["hardware"] = {"cpus": 1, "processor": "Z80"}


@pytest.fixture
def evaluated(monkeypatch, tmp_path):
    """A run, whose evaluations note their rows and write a report at once."""
    done = []

    def write(run, trained, seed, name):
        facts = {"seed": seed, "robot": "a1", "transporter": "single_board"}
        figures = {"survival": 1.0, "n": 5, "settled_speed_error": 0.1, "settled_yaw_error": None}
        (run / name).mkdir(exist_ok=True)
        (run / name / "metrics.json").write_text(json.dumps({"run": trained, "evaluation": facts, **figures}))

    def call(_, run, *words):
        folder = words[words.index("--output") + 1]
        done.append(folder.name)
        write(run, json.loads((run / "run.json").read_text()), words[words.index("--seed") + 1], folder.name)

    monkeypatch.setattr(results, "call", call)
    (tmp_path / "run.json").write_text(json.dumps(TRAINED))
    return done


def test_rows_of_another_training_or_seed_are_measured_again(evaluated, tmp_path):
    rows = ("tracking", "area-5x1")
    assert scorecard.measure(tmp_path, 3, rows)["command"].endswith("--seed 3 --rows tracking area-5x1")
    assert evaluated == list(rows)
    scorecard.measure(tmp_path, 3, rows)
    assert evaluated == list(rows)
    (tmp_path / "run.json").write_text(json.dumps(TRAINED | {"frames": 2}))
    assert scorecard.measure(tmp_path, 3, rows)["run"]["frames"] == 2
    assert evaluated == [*rows, *rows]
    scorecard.measure(tmp_path, 4, ["tracking"])
    assert evaluated == [*rows, *rows, "tracking"]


def test_a_failed_or_stopped_command_is_named(capsys, monkeypatch):
    with pytest.raises(UserError, match="`torchrl-atr verify nowhere` failed"):
        results.call("verify", "nowhere")
    assert "no policy bundle at nowhere" in capsys.readouterr().err
    monkeypatch.setattr(results.cli, "main", lambda words: 143)
    with pytest.raises(Stopped) as stop:
        results.call("evaluate", "run")
    assert stop.value.signal == 15


def test_a_row_has_survival_with_its_interval_and_what_there_is_of_errors():
    metrics = {"survival": 0.88, "n": 400, "settled_speed_error": 0.328, "settled_yaw_error": None}
    text = scorecard.row("endurance", {**metrics, "survival_interval": [0.844, 0.908]})
    assert text == "| 60 s, pushes, commands change every 5 s | 400 | 88.0% [84.4%, 90.8%] | 0.328 | - | - |"
    assert "88.0% [84.4%, 90.8%]" in scorecard.row("tracking", {**metrics, "commands_mastered": 0.3})


def test_every_row_is_a_call_of_evaluate():
    from torchrl_atr.cli.parser import build_parser
    from torchrl_atr.cli.protocols import fill_options

    for _, options in scorecard.EVALUATIONS.values():
        arguments = build_parser().parse_args(["evaluate", "run", *options])
        fill_options(arguments)
        assert arguments.randomization in ("train", "test")

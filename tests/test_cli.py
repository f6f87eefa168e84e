"""The command line: what it lists, and how it refuses bad input."""

from __future__ import annotations

import json

import pytest

from torchrl_atr.cli import main


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("robots", "a1"),
        ("transporters", "single_board"),
        ("profiles", "literal"),
        ("estimators", "cnn_gru"),
        ("rewards", "termination"),
    ],
)
def test_list(capsys, what, expected):
    assert main(["list", what]) == 0
    assert expected in capsys.readouterr().out.split()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "--robot", "a2"], "unknown robot 'a2'; known: a1"),
        (["train", "--transporter", "sled"], "unknown transporter 'sled'"),
        (["train", "--profile", "mine"], "unknown profile 'mine'"),
        (["train", "--estimator", "oracle"], "oracle"),
        (["train", "--set", "gama=1"], "unknown setting 'gama'"),
        (["train", "--set", "gamma=2"], "gamma=2.0 is out of range"),
        (["train", "--import", "no_such_module"], "no_such_module"),
        (["train", "--config", "nowhere.toml"], "no configuration file nowhere.toml"),
        (["train", "--resume", "nowhere"], "there is no checkpoint at nowhere"),
        (["evaluate", "nowhere"], "there is no checkpoint at nowhere"),
        (["play", "nowhere"], "there is no checkpoint at nowhere"),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) <= 3
    assert not list(tmp_path.iterdir())


def test_train_evaluate_resume(tmp_path, capsys):
    run, report = tmp_path / "run", tmp_path / "report"
    tiny = ["--num-envs", "4", "--set", "rollout_steps=4", "--set", "minibatches=1", "--set", "num_threads=1"]
    assert main(["train", *tiny, "--total-frames", "32", "--output", str(run)]) == 0
    grid = ["--max-speed", "1", "--speed-step", "1", "--max-yaw-rate", "0", "--robots-per-command", "1"]
    assert main(["evaluate", str(run), *grid, "--output", str(report)]) == 0
    assert "do nothing" in capsys.readouterr().out
    metrics = json.loads((report / "metrics.json").read_text())
    assert metrics["n"] == 3
    assert metrics["run"]["frames"] == 32
    assert set(metrics["policy_reads"]) == {"history", "observation"}
    names = {"metrics.json", "tracking.npz", "heatmaps.png", "learning_curves.png", "curriculum.png"}
    assert names <= {file.name for file in report.iterdir()}
    assert main(["train", "--resume", str(run), "--total-frames", "48"]) == 0
    assert json.loads((run / "run.json").read_text())["frames"] == 48


def test_unknown_command_is_argparse_exit_2():
    with pytest.raises(SystemExit) as stop:
        main(["fly"])
    assert stop.value.code == 2

"""The command line: what it lists, and how it refuses bad input."""

from __future__ import annotations

import dataclasses
import json
from functools import partial

import mujoco
import pytest

from torchrl_atr import evaluation
from torchrl_atr.cli import main
from torchrl_atr.modules import CommandClippedPolicy, CommandRange
from torchrl_atr.training import load_run, read_config

pytestmark = pytest.mark.usefixtures("undrawn")

TINY = ["--num-envs", "2", "--ppo.rollout-steps", "4", "--ppo.minibatches", "1", "--compute.num-threads", "1"]


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("robots", "a1"),
        ("transporters", "single_board"),
        ("presets", "literal"),
        ("questions", "(A9):"),
        ("settings", "ppo.gamma"),
        ("additions", "ppo.symmetric"),
        ("estimators", "cnn_gru"),
        ("rewards", "termination"),
        ("rewards", "turning_command"),
        ("tasks", "walking"),
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
        (["train", "--preset", "mine"], "unknown preset 'mine'"),
        (["train", "--estimator", "oracle"], "oracle"),
        (["train", "--ppo.gama", "1"], "unknown argument '--ppo.gama'"),
        (["train", "--ppo.gamma", "2"], "ppo.gamma=2.0 is out of range"),
        (["train", "--import", "no_such_module"], "cannot import 'no_such_module'"),
        (["train", "--device", "abacus"], "compute.device='abacus' is unknown; use 'cpu' or 'cuda'"),
        (["train", "--env.episode-seconds", "2"], "must not exceed env.episode_seconds=2"),
        (["model", "a1", "sled", "--output", "x.xml"], "unknown transporter 'sled'"),
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


@pytest.mark.usefixtures("short_trials")
def test_train_evaluate_resume(tmp_path, capsys):
    run, report = tmp_path / "run", tmp_path / "report"
    tiny = ["--num-envs", "4", "--ppo.rollout-steps", "4", "--ppo.minibatches", "1", "--compute.num-threads", "1"]
    assert main(["train", *tiny, "--total-frames", "32", "--output", str(run)]) == 0
    grid = ["--max-speed", "1", "--speed-step", "1", "--max-yaw-rate", "0", "--robots-per-command", "1"]
    assert main(["evaluate", str(run), *grid, "--output", str(report)]) == 0
    assert "still board" in capsys.readouterr().out
    metrics = json.loads((report / "metrics.json").read_text())
    assert metrics["n"] == 3
    assert metrics["run"]["frames"] == 32
    assert set(metrics["policy_reads"]) == {"history", "observation", "dead_reckoned_velocity"}
    names = {"metrics.json", "tracking.npz", "heatmaps.png", "learning_curves.png", "curriculum.png"}
    assert names <= {file.name for file in report.iterdir()}
    assert main(["train", "--resume", str(run), "--total-frames", "48"]) == 0
    assert json.loads((run / "run.json").read_text())["frames"] == 48


def test_endurance_beside_tracking(tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["train", *TINY, "--total-frames", "8", "--output", str(run)]) == 0
    asked = ["evaluate", str(run), "--protocol", "endurance", "--robots", "3", "--seconds", "1"]
    assert main(asked) == 0
    assert "up at 1 s, share" in capsys.readouterr().out
    report = run / "endurance"
    metrics = json.loads((report / "metrics.json").read_text())
    assert {"metrics.json", "endurance.npz", "endurance.png"} <= {file.name for file in report.iterdir()}
    assert not (run / "metrics.json").exists()
    assert (metrics["protocol"], metrics["n"], metrics["push_seconds"]) == ("endurance", 3, 3.0)
    assert "privileged.intrinsic" not in metrics["policy_reads"]
    assert metrics["evaluation"]["sensors"] == "realistic"
    still = ["--max-speed", "0", "--max-yaw-rate", "0", "--no-pushes", "--act-source", "privileged"]
    still += ["--sensors", "ideal"]
    assert main([*asked, *still, "--checkpoint", "last", "--output", str(tmp_path / "still")]) == 0
    metrics = json.loads((tmp_path / "still" / "metrics.json").read_text())
    assert metrics["commands"] == {"low": [0.0, 0.0], "high": [0.0, 0.0]}
    assert metrics["push_seconds"] is None
    assert "privileged.intrinsic" in metrics["policy_reads"]
    assert metrics["evaluation"]["act_source"] == "privileged"
    assert metrics["evaluation"]["sensors"] == "ideal"
    assert main([*asked, "--transporter", "two_board"]) == 2
    assert "give another folder with --output" in capsys.readouterr().err


@pytest.mark.usefixtures("short_trials")
def test_a_policy_rides_another_transporter_by_name(tmp_path, capsys, monkeypatch):
    run, report = tmp_path / "run", tmp_path / "report"
    assert main(["train", *TINY, "--total-frames", "8", "--output", str(run)]) == 0
    grid = ["--max-speed", "0", "--max-yaw-rate", "0", "--robots-per-command", "1"]
    asked = ["evaluate", str(run), *grid, "--transporter", "two_board"]
    for output in ([], ["--output", str(run)]):
        assert main([*asked, *output]) == 2
        assert "give another folder with --output" in capsys.readouterr().err
    assert main([*asked, "--output", str(report)]) == 0
    metrics = json.loads((report / "metrics.json").read_text())
    assert metrics["evaluation"]["transporter"] == "two_board_g1"
    assert "--transporter single_board" in metrics["run"]["command"]
    assert not (run / "metrics.json").exists()
    ridden = []
    monkeypatch.setattr(evaluation, "record_video", lambda policy, env, *_, **__: ridden.append(env))
    assert main(["play", str(run), "--transporter", "single_board_g2", "--video", "ride.gif"]) == 0
    assert ridden[0].base_env.scene.support.spec.name == "single_board_g2"
    for command in (["evaluate", str(run), "--output", str(report)], ["play", str(run)]):
        assert main([*command, "--transporter", "sled"]) == 2
        assert "unknown transporter 'sled'; known: single_board, two_board" in capsys.readouterr().err


def watched(measure, policies, policy, *arguments, **options):
    policies.append(policy)
    return measure(policy, *arguments, **options)


@pytest.mark.usefixtures("short_trials")
def test_commands_are_clipped_to_the_range_that_an_evaluation_recorded(tmp_path, capsys, monkeypatch):
    run, ranges = tmp_path / "run", [CommandRange(0.5, 0.2, 0.1), None]
    assert main(["train", *TINY, "--total-frames", "8", "--output", str(run)]) == 0
    monkeypatch.setattr(evaluation, "mastered_range", lambda result: ranges.pop(0))
    measure, measured = evaluation.evaluate_tracking, []
    monkeypatch.setattr(evaluation, "evaluate_tracking", partial(watched, measure, measured))
    few = ["evaluate", str(run), "--max-speed", "0", "--max-yaw-rate", "0", "--robots-per-command", "1"]

    def applied() -> dict[str, float] | None:
        return json.loads((run / "metrics.json").read_text())["evaluation"]["command_range"]

    assert main([*few, "--command-range", "record"]) == 0
    assert "from now on commands are clipped to it" in capsys.readouterr().out
    assert applied() is None
    assert isinstance(load_run(run)[2].deployed_policy(), CommandClippedPolicy)
    assert main(few) == 0
    assert applied() == dataclasses.asdict(CommandRange(0.5, 0.2, 0.1))
    assert main([*few, "--act-source", "privileged"]) == 0
    assert [isinstance(policy, CommandClippedPolicy) for policy in measured] == [False, True, True]
    assert main([*few, "--command-range", "record"]) == 0
    assert "no command is mastered" in capsys.readouterr().out
    assert not (run / "command_range.json").exists()
    other = ["--transporter", "two_board", "--output", str(tmp_path / "report")]
    assert main([*few, "--command-range", "record", *other]) == 2
    assert "leave out --transporter" in capsys.readouterr().err


def test_a_run_is_not_overwritten_and_a_resumed_one_keeps_its_settings(tmp_path, capsys):
    run = tmp_path / "run"
    run.mkdir()
    (run / "checkpoint.pt").touch()
    assert main(["train", "--output", str(run)]) == 2
    assert "holds a run; give another --output" in capsys.readouterr().err
    assert main(["train", "--resume", str(run), "--seed", "5", "--ppo.gamma", "0.9"]) == 2
    assert "--seed, --ppo.gamma: a resumed run keeps its settings" in capsys.readouterr().err
    assert (run / "checkpoint.pt").stat().st_size == 0


def test_an_estimator_of_ones_own_trains_from_the_command_line(tmp_path, monkeypatch):
    (tmp_path / "my_estimators.py").write_text(
        "from torchrl_atr.modules import MLPEstimator, register_estimator\n"
        "register_estimator('from_a_module', MLPEstimator)\n"
    )
    monkeypatch.chdir(tmp_path)
    arguments = ["train", *TINY, "--total-frames", "8", "--import", "my_estimators", "--estimator", "from_a_module"]
    assert main([*arguments, "--output", "run"]) == 0
    assert read_config(tmp_path / "run" / "config.toml")["imports"] == ["my_estimators"]


def test_a_transporter_of_ones_own_trains_and_is_evaluated_from_the_command_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_decks.py").write_text(
        "from dataclasses import replace\n"
        "from torchrl_atr.envs import TRANSPORTERS\n"
        "TRANSPORTERS.register('wide', replace(TRANSPORTERS.get('two_board_g1'), name='wide', size=(0.9, 0.9, 0.05)))\n"
    )
    monkeypatch.chdir(tmp_path)
    mine = ["--import", "my_decks"]
    assert main(["list", "transporters", *mine]) == 0
    assert "wide" in capsys.readouterr().out
    assert main(["model", "a1", "wide", *mine, "--output", "scene.xml"]) == 0
    assert main(["train", *TINY, "--total-frames", "8", *mine, "--transporter", "wide", "--output", "run"]) == 0
    few = ["--max-speed", "1", "--max-yaw-rate", "0.25", "--robots-per-command", "1"]
    assert main(["evaluate", "run", *few]) == 0
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["evaluation"]["transporter"] == "wide"


def test_model_writes_a_scene_that_mujoco_opens(tmp_path):
    path = tmp_path / "scene.xml"
    assert main(["model", "a1", "single_board", "--output", str(path)]) == 0
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.key("stand").qpos.shape == (model.nq,)


def test_unknown_command_is_argparse_exit_2():
    with pytest.raises(SystemExit) as stop:
        main(["fly"])
    assert stop.value.code == 2

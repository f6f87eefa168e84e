"""A run folder holds what it needs: moved, and with its robot's files changed or gone, it is what it was."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from tests.own_robot import FACTS, GO1, make_heavier, write_robot
from torchrl_atr.cli import main
from torchrl_atr.envs.models.identity import differences
from torchrl_atr.evaluation import replay_failure
from torchrl_atr.runs.files import DUMPS
from torchrl_atr.training import Trainer, load_checkpoint, load_run, make_config, read_config

pytestmark = pytest.mark.usefixtures("undrawn")

TINY = {
    "env.num_envs": 4,
    "ppo.rollout_steps": 4,
    "total_frames": 32,
    "compute.num_threads": 1,
    "compute.torch_threads": 1,
    "ppo.minibatches": 1,
    "ppo.critic_cells": [8],
}
GRID = ["--max-speed", "0", "--max-yaw-rate", "0", "--robots-per-command", "1"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    """A folder with a run of a robot whose files are elsewhere, and one dump of it; only to be copied."""
    folder = tmp_path_factory.mktemp("trained")
    toml = write_robot(folder / "source")
    trainer = Trainer(make_config({**TINY, "task.robot": str(toml)}), folder / "run")
    trainer.train()
    env = trainer.env
    env.rollout(3)
    env.base_env._recorder.dump(0, "a test")
    return folder


@pytest.fixture(params=["gone", "edited"])
def moved(request, trained, tmp_path) -> Iterator[Path]:
    """The run in another place; the files that it was made of are gone from theirs, or say something else."""
    run = shutil.copytree(trained / "run", tmp_path / "after" / "run")
    source, hidden = trained / "source", tmp_path / "hidden"
    shutil.move(source, hidden)
    if request.param == "edited":
        make_heavier(shutil.copytree(hidden, source) / "xml" / "mine.xml")
    yield run
    shutil.rmtree(source, ignore_errors=True)
    shutil.move(hidden, source)


def trunk_mass(env) -> float:
    return float(env.base_env.model.body("trunk").mass[0])


def test_it_holds_the_files_and_names_them_relative_to_itself(trained):
    run = trained / "run"
    names = {file.name for file in (run / "model").rglob("*") if file.is_file()}
    assert names == {"mine.toml", "mine.xml", "more.xml", "a.stl", "t.png"}
    for settings in (load_checkpoint(run)["config"], tomllib.loads((run / "config.toml").read_text())):
        assert settings["task"]["robot"] == "model/robot/mine.toml"
    origin = json.loads((run / "run.json").read_text())
    assert origin["command"].startswith("torchrl-atr train --robot model/robot/mine.toml")
    assert len(origin["model"]) == 64
    assert not [path for path in run.iterdir() if path.name.startswith(".")]


def test_no_absolute_path_is_written(trained):
    for file in (trained / "run").rglob("*"):
        if file.is_file():
            assert str(trained).encode() not in file.read_bytes(), file


def test_it_is_evaluated_with_what_it_was_trained_on(trained, moved, tmp_path):
    _, env, _, state = load_run(moved, num_envs=1)
    assert env.base_env.scene.robot.name == "mine"
    assert trunk_mass(env) == state["model"]["robot"]["body trunk"]["body_mass"]
    assert main(["evaluate", str(moved), *GRID, "--output", str(tmp_path / "report")]) == 0
    assert json.loads((tmp_path / "report" / "metrics.json").read_text())["evaluation"]["robot"] == "mine"


def test_it_goes_on_and_others_begin_from_it(trained, moved, tmp_path, capsys):
    assert main(["train", "--resume", str(moved), "--total-frames", "64"]) == 0
    begun = tmp_path / "begun"
    assert main(["train", "--from", str(moved), "--output", str(begun)]) == 0
    states = [load_checkpoint(folder) for folder in (trained / "run", moved, begun)]
    assert [state["config"]["task"]["robot"] for state in states] == ["model/robot/mine.toml"] * 3
    assert differences(states[0]["model"], states[1]["model"]) == []
    assert differences(states[0]["model"], states[2]["model"]) == []
    shutil.rmtree(moved)  # it needs the other no more
    assert load_run(begun, num_envs=1)[1].base_env.scene.robot.name == "mine"


def test_its_dumps_are_replayed(moved):
    (dump,) = (moved / DUMPS).iterdir()
    assert len(list(replay_failure(dump))) == 3
    assert main(["replay", str(dump)]) == 0


def test_its_settings_are_read_from_its_folder(moved, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert make_config(read_config(moved / "config.toml")).task.robot == str(moved / "model" / "robot" / "mine.toml")
    again = ["train", "--config", str(moved / "config.toml"), "--output", str(moved), "--overwrite"]
    assert main(again) == 0  # the files that it is made of lie in what it overwrites
    assert load_run(moved, num_envs=1)[1].base_env.scene.robot.name == "mine"


def test_a_run_over_another_keeps_nothing_of_its_model(trained, tmp_path):
    run = shutil.copytree(trained / "run", tmp_path / "run")
    Trainer(make_config(TINY), run)
    assert not (run / "model").exists()


def test_a_robot_file_that_changed_under_a_run_is_named(trained, tmp_path, capsys):
    run = shutil.copytree(trained / "run", tmp_path / "run")
    make_heavier(run / "model" / "robot" / "xml" / "mine.xml")
    assert main(["evaluate", str(run), *GRID]) == 2
    message = capsys.readouterr().err
    assert f"{run} was trained with another robot 'mine' than there is here (body_mass of body trunk" in message
    assert "--robot NAME" in message


def test_training_with_files_is_training_without(tmp_path):
    """Copying changes no number: the robot that is given by a file learns what the registered one does."""
    facts = {**FACTS, "name": "go1", "mjcf": str(GO1.mjcf)}
    (tmp_path / "go1.toml").write_text("\n".join(f"{name} = {json.dumps(value)}" for name, value in facts.items()))
    ends = []
    for robot in ("go1", str(tmp_path / "go1.toml")):
        run = tmp_path / f"run{len(ends)}"
        Trainer(make_config({**TINY, "task.robot": robot}), run).train()
        ends.append(load_checkpoint(run)["learner"]["networks"])
    for name, value in ends[0].items():
        assert torch.equal(value, ends[1][name]), name


def test_a_transporter_of_ones_own_is_kept_too(tmp_path, capsys):
    pytest.importorskip("torchrl_atr.envs.models.spec_file")
    deck = tmp_path / "source" / "wide.toml"
    deck.parent.mkdir()
    deck.write_text('name = "wide"\ndesign = "two_board"\nsize = [0.9, 0.9, 0.05]\nmass = 14.0\n')
    trainer = Trainer(make_config({**TINY, "task.transporter": str(deck)}), tmp_path / "run")
    trainer.train()
    trainer.env.rollout(2)
    trainer.env.base_env._recorder.dump(0, "a test")
    shutil.rmtree(deck.parent)
    run = Path(shutil.move(tmp_path / "run", tmp_path / "moved"))
    assert load_checkpoint(run)["config"]["task"]["transporter"] == "model/transporter/wide.toml"
    assert load_run(run, num_envs=1)[1].base_env.scene.support.spec.mass == 14.0
    (dump,) = (run / DUMPS).iterdir()
    assert len(list(replay_failure(dump))) == 2
    copy = run / "model" / "transporter" / "wide.toml"
    copy.write_text(copy.read_text().replace("14.0", "15.0"))
    assert main(["evaluate", str(run), *GRID]) == 2
    assert "the transporter's mass: 14 then, 15 now" in capsys.readouterr().err

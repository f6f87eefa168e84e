"""A model that is not the one a run was trained with is named, and used only where it is asked for."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from torchrl_atr.cli import main
from torchrl_atr.envs import ROBOTS, TRANSPORTERS
from torchrl_atr.training import CheckpointError, Trainer, load_checkpoint, load_run, make_config

pytestmark = pytest.mark.usefixtures("undrawn")

TINY = {
    "env.num_envs": 2,
    "ppo.rollout_steps": 2,
    "total_frames": 8,
    "compute.num_threads": 1,
    "ppo.minibatches": 1,
    "ppo.critic_cells": [8],
}
GRID = ["--max-speed", "0", "--max-yaw-rate", "0", "--robots-per-command", "1"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    Trainer(make_config(TINY), folder).train()
    return folder


@pytest.fixture
def heavier(monkeypatch, tmp_path):
    """The registered ``a1`` has heavier thighs than when the run was trained."""
    text = ROBOTS.get("a1").mjcf.read_text()
    (tmp_path / "a1.xml").write_text(text.replace('mass="1.013"', 'mass="2"'))
    monkeypatch.setitem(ROBOTS._entries, "a1", dataclasses.replace(ROBOTS.get("a1"), mjcf=tmp_path / "a1.xml"))


@pytest.fixture
def slower(monkeypatch):
    """The registered single board accelerates less."""
    deck = TRANSPORTERS.get("single_board_g1")
    monkeypatch.setitem(TRANSPORTERS._entries, deck.name, dataclasses.replace(deck, max_acceleration=6.0))


def refused(capsys, *arguments):
    assert main([str(argument) for argument in arguments]) == 2
    message = capsys.readouterr().err
    assert len(message.strip().splitlines()) <= 3
    assert len(message) <= 480 + len("torchrl-atr evaluate: ")
    return message


@pytest.mark.parametrize("command", ["evaluate", "play", "train --resume", "train --output new --from"])
def test_a_changed_robot_is_refused_by_name_and_field(run, heavier, capsys, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    message = refused(capsys, *command.split(), run)
    assert f"{run} was trained with another robot 'a1' than there is here" in message
    assert "body FR_thigh" in message
    assert f"name what is to take its place with --robot NAME of evaluate, play or train --from {run}" in message
    assert not (tmp_path / "new").exists()


def test_a_changed_transporter_is_refused_by_name_and_field(run, slower, capsys):
    message = refused(capsys, "evaluate", run)
    assert "another transporter 'single_board_g1'" in message
    assert "the transporter's max_acceleration: 12 then, 6 now" in message
    assert "--transporter NAME" in message


@pytest.mark.usefixtures("short_trials")
def test_what_is_asked_for_is_used(run, heavier, tmp_path):
    _, env, networks, _ = load_run(run, robot="a1", num_envs=1)
    assert float(env.base_env.model.body("FR_thigh").mass[0]) == 2.0
    assert env.rollout(2, networks.deployed_policy())["action"].isfinite().all()
    report = ["--output", str(tmp_path / "report")]
    assert main(["evaluate", str(run), "--robot", "a1", *GRID, *report]) == 0
    assert main(["evaluate", str(run), "--robot", "go1", *GRID, *report]) == 0
    for index, choice in enumerate((["--robot", "a1"], ["--robot", "go1"], ["--task.robot", "a1"])):
        assert main(["train", "--from", str(run), *choice, "--output", str(tmp_path / str(index))]) == 0


def test_another_transporter_is_no_excuse_for_another_robot(run, heavier, capsys, tmp_path):
    message = refused(capsys, "evaluate", run, "--transporter", "two_board", "--output", tmp_path)
    assert "another robot 'a1'" in message


def test_a_changed_transporter_does_not_matter_on_another(run, slower):
    assert load_run(run, transporter="two_board", num_envs=1)[1].base_env.scene.support.spec.name == "two_board_g1"
    with pytest.raises(CheckpointError, match="another transporter"):
        load_run(run, robot="go1", num_envs=1)


def test_a_report_on_another_robot_does_not_replace_the_runs_own(run, capsys):
    message = refused(capsys, "evaluate", run, "--robot", "go1")
    assert "--robot go1: the report in" in message
    assert "--output" in message


def test_a_run_from_before_models_were_recorded_is_used_as_ever(run, heavier, tmp_path):
    state = load_checkpoint(run)
    del state["model"]
    torch.save(state, tmp_path / "checkpoint.pt")
    load_run(tmp_path, num_envs=1)
    Trainer(make_config({**TINY, "total_frames": 16}), tmp_path, state).train()
    assert load_checkpoint(tmp_path)["model"]["robot"]["body FR_thigh"]["body_mass"] == 2.0  # from now on

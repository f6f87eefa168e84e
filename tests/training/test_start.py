"""A run that begins with what another one has learned."""

from __future__ import annotations

import json

import pytest
import torch

from torchrl_atr.cli import main
from torchrl_atr.envs.transforms import CommandGrid
from torchrl_atr.training import Trainer, load_checkpoint, make_config

TINY = {"num_envs": 8, "rollout_steps": 8, "total_frames": 64, "num_threads": 1, "gamma": 0.9, "max_speed": 3.0}


@pytest.fixture(scope="module")
def parent(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "parent"
    Trainer(make_config(TINY), folder).train()
    return folder


def test_deployed_networks_and_command_grid_are_the_other_runs_and_all_else_is_new(parent, tmp_path):
    learned = load_checkpoint(parent)
    trainer = Trainer(make_config({**TINY, "max_speed": 15.0, "seed": 7}), tmp_path / "run", start=parent)
    for name, value in trainer.learner.networks.state_dict().items():
        assert torch.equal(value, learned["learner"]["deployed"][name]), name
    narrow, wide = CommandGrid(bounds=(3.0, 2.0)), trainer.curriculum
    assert wide.weights.shape == (151, 21)
    assert wide.grid.area(wide.weights)[1] == pytest.approx(narrow.area(learned["curriculum"]["weights"])[1])
    assert trainer.frames == trainer.seconds == 0
    assert not trainer.learner.optimizers["policy"].state


def test_the_command_line_keeps_the_settings_and_says_where_the_run_comes_from(parent, tmp_path):
    run = tmp_path / "run"
    assert main(["train", "--from", str(parent), "--output", str(run), "--set", "final_std=0.05"]) == 0
    assert main(["train", "--resume", str(run), "--total-frames", "128"]) == 0
    state, origin = load_checkpoint(run), json.loads((run / "run.json").read_text())
    assert (state["config"]["gamma"], state["config"]["final_std"]) == (0.9, 0.05)
    assert (
        origin["command"] == f"torchrl-atr train --from {parent} --seed 0 --set total_frames=128 --set final_std=0.05"
    )
    assert origin["from"] == {"run": str(parent), **load_checkpoint(parent)["provenance"]}
    assert state["provenance"] == origin

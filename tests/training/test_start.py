"""A run that begins with what another one has learned."""

from __future__ import annotations

import json

import pytest
import torch

from torchrl_atr.cli import main
from torchrl_atr.envs.transforms import CommandGrid
from torchrl_atr.training import CheckpointError, Trainer, load_checkpoint, make_config

TINY = {
    "env.num_envs": 8,
    "ppo.rollout_steps": 8,
    "total_frames": 64,
    "compute.num_threads": 1,
    "ppo.gamma": 0.9,
    "curriculum.max_speed": 3.0,
    "curriculum.max_yaw_rate": 2.0,
}


@pytest.fixture(scope="module")
def parent(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "parent"
    Trainer(make_config(TINY), folder).train()
    return folder


def test_a_run_begins_with_anothers_deployed_networks_and_command_grid(parent, tmp_path):
    learned = load_checkpoint(parent)
    trainer = Trainer(
        make_config({**TINY, "curriculum.max_speed": 15.0, "seed": 7}), tmp_path / "run", begin_from=parent
    )
    for name, value in trainer.learner.networks.state_dict().items():
        assert torch.equal(value, learned["learner"]["deployed"][name]), name
    narrow, wide = CommandGrid(bounds=(3.0, 2.0)), trainer.curriculum
    assert wide.weights.shape == (151, 21)
    assert wide.grid.area(wide.weights)[1] == pytest.approx(narrow.area(learned["curriculum"]["weights"])[1])
    assert trainer.frames == trainer.seconds == 0


def test_optimisers_go_on_where_the_other_run_ended_with_settings_of_their_own(parent, tmp_path):
    before = load_checkpoint(parent)["learner"]["optimizers"]
    config = make_config({**TINY, "ppo.critic_learning_rate": 2e-4, "ppo.learning_rate": 1e-3})
    learner = Trainer(config, tmp_path / "run", begin_from=parent).learner
    for name, optimizer in learner.optimizers.items():
        moments = optimizer.state_dict()["state"]
        assert moments.keys() == before[name]["state"].keys() != set(), name
        for index, entries in before[name]["state"].items():
            assert all(torch.equal(moments[index][key], value) for key, value in entries.items()), name
    rate = float(before["policy"]["param_groups"][0]["lr"])
    assert learner.schedule.get_last_lr() == [pytest.approx(rate)]
    assert learner.optimizers["critic"].param_groups[0]["lr"] == 2e-4
    learner.schedule.step(torch.tensor(1e9))
    assert learner.optimizers["policy"].param_groups[0]["lr"] < rate  # the schedule's own, not a copy
    slower = make_config({**TINY, "ppo.learning_rate": rate / 2})
    begun = Trainer(slower, tmp_path / "slower", begin_from=parent).learner
    assert begun.schedule.get_last_lr() == [pytest.approx(rate / 2)]


def test_moments_of_other_parameters_are_refused_by_name(parent, tmp_path):
    learner = Trainer(make_config(TINY), tmp_path / "run", begin_from=parent).learner
    for damage in (
        lambda saved: saved["state"][0].update(exp_avg=torch.zeros(3)),
        lambda saved: saved["param_groups"][0]["params"].append(99),
    ):
        state = load_checkpoint(parent)["learner"]
        damage(state["optimizers"]["critic"])
        for load in (learner.begin_from, learner.load_state_dict):
            with pytest.raises(CheckpointError, match="'critic' optimiser"):
                load(state)


def test_the_command_line_keeps_the_settings_and_says_where_the_run_comes_from(parent, tmp_path):
    run = tmp_path / "run"
    assert main(["train", "--from", str(parent), "--output", str(run), "--exploration.final-std", "0.05"]) == 0
    assert main(["train", "--resume", str(run), "--total-frames", "128"]) == 0
    state, origin = load_checkpoint(run), json.loads((run / "run.json").read_text())
    config = state["config"]
    assert (config["ppo"]["gamma"], config["exploration"]["final_std"]) == (0.9, 0.05)
    assert (
        origin["command"]
        == f"torchrl-atr train --from {parent} --seed 0 --total-frames 128 --exploration.final-std 0.05"
    )
    assert origin["from"] == {"run": str(parent), **load_checkpoint(parent)["provenance"]}
    assert state["provenance"] == origin

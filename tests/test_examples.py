"""The examples run, and are short enough to read."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from statistics import median

import pytest
import torch

from torchrl_atr.modules import available_estimators, check_estimator, get_estimator

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name: str):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_examples_stay_short(path):
    assert len(path.read_text().splitlines()) < 150


def test_the_raw_loop_trains():
    rewards = load("raw_loop").main(iterations=2, num_envs=8, steps=6)
    assert len(rewards) == 2
    assert all(math.isfinite(reward) for reward in rewards)


def test_parts_of_ones_own_train_and_go_on_and_are_evaluated(tmp_path):
    trainer = load("own_parts").main(tmp_path / "run")
    assert trainer.iteration == 3
    scalars = tmp_path / "run" / "scalars" / "scalars" / "train"
    assert len((scalars / "reward_std.csv").read_text().splitlines()) == 3
    assert trainer.parts.names == {"make_env": "own_parts.make_env", "make_networks": "own_parts.make_small_networks"}


def test_an_estimator_of_ones_own():
    load("own_estimator")
    assert "dilated" in available_estimators()
    check_estimator(get_estimator("dilated"), history_shape=(7, 5), out_features=3)


@pytest.mark.parametrize("role", ["intrinsic", "extrinsic", "both"])
def test_an_estimator_of_ones_own_with_a_memory(role):
    if "predictive_gru" not in available_estimators():
        load("own_memory")
    check_estimator(get_estimator("predictive_gru"), (7, 5), 3, role, width=8)


@pytest.mark.parametrize("library", ["dm_control", "gymnasium"])
def test_the_loss_and_estimators_learn_hidden_parameters_of_another_library(library):
    pytest.importorskip(library)
    example = load("hidden_parameters")
    env = example.make_one(library, seed=0)
    masses, told = [], []
    for _ in range(2):
        told.append(env.reset()["privileged", "intrinsic"])
        masses.append(float(example.simulation(env)[0].body_mass.sum()))
    assert masses[0] / masses[1] == pytest.approx(float((1 + 0.5 * told[0][0]) / (1 + 0.5 * told[1][0])), rel=1e-5)
    ride = env.rollout(8)
    torch.testing.assert_close(ride["history"][-1], ride["observation"][-6:-1])
    torch.testing.assert_close(ride["observation"][1:, -6:], ride["action"][:-1].clamp(-1, 1), check_dtype=False)
    networks, explained = example.main(library, iterations=6, num_envs=4, steps=64)
    assert median(explained[-3:]) > explained[0]  # a batch in which a cheetah tumbles is an outlier
    assert sorted(networks.deployed_policy().in_keys) == ["history", "observation"]


def test_our_env_trains_with_stock_sac():
    losses = load("stock_sac").main(frames=8 * 4 * 12, num_envs=8, batch=32, cells=16)
    assert len(losses) == 12
    assert all(map(math.isfinite, losses))


def test_our_env_trains_with_a_recurrent_policy_in_stock_ppo():
    rewards, ratios = load("recurrent_ppo").main(iterations=2, num_envs=8, steps=6, features=16)
    assert len(rewards) == 2
    assert ratios == pytest.approx([1.0, 1.0], abs=1e-4)  # the states of the rollout are those of the loss


def test_an_estimator_learns_from_a_replay_buffer_on_disk(tmp_path):
    example = load("offline_estimator")
    example.record(tmp_path / "rides", num_envs=16, steps=40)
    _, explained = example.train(tmp_path / "rides", "mlp", epochs=4, size=16 * 40, held_out=4 * 40)
    assert explained[-1] > max(explained[0], 0.0) + 0.2


def test_curriculum_and_history_work_on_an_env_that_knows_neither():
    example = load("foreign_transforms")
    first, last = example.main(steps=150, num_envs=16)
    assert last[0] > first[0]
    assert last[1] > first[1]
    ride = example.make_env(num_envs=2).rollout(6, lambda td: td.set("action", example.helm(td["observation"])))
    torch.testing.assert_close(ride["history"][:, 5], ride["observation"][:, 1:5])
    torch.testing.assert_close(ride["observation"][..., 2:], ride["command"])

"""The examples run, and are short enough to read."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import pytest

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

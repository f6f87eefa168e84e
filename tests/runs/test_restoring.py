"""Settings of a checkpoint: what older ones did without, and what a new run has other than the one before."""

from __future__ import annotations

import pytest

from torchrl_atr.config import make_config
from torchrl_atr.runs.restoring import checkpoint_config, other_parts


def test_a_run_from_before_the_weight_of_a_fall_learned_from_the_papers(tmp_path):
    """Its factor of r17 is 1 then, not what new runs have."""
    parts = dict.fromkeys(("curriculum", "frames", "rng", "provenance"))
    state = {"config": make_config().to_dict(), "learner": dict.fromkeys(("networks", "optimizers")), **parts}
    del state["config"]["task"]["fall_weight"]
    assert checkpoint_config(state, tmp_path).task.fall_weight == 1.0
    state["config"]["task"]["fall_weight"] = 40.0
    assert checkpoint_config(state, tmp_path).task.fall_weight == 40.0


@pytest.mark.parametrize(
    ("changed", "parts"),
    [
        ({}, set()),
        ({"task.kp": 30.0}, {"robot"}),
        ({"task.kd": 0.7}, {"robot"}),
        ({"task.robot": "go1"}, {"robot"}),
        ({"task.transporter": "two_board"}, {"transporter"}),
        ({"task.transporter": "two_board", "task.kd": 0.7}, {"robot", "transporter"}),
    ],
)
def test_other_gains_make_another_robot(tmp_path, changed, parts):
    before = {"task.kp": 25.0, "task.kd": 0.6}
    other = {"run": str(tmp_path), "config": make_config(before).to_dict()}
    assert other_parts(make_config({**before, **changed}), other) == parts

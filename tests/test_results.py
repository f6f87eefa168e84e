"""What is published still works with the code beside it."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from torchrl_atr.evaluation import evaluate_tracking
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, load_run, make_env

RUNS = sorted(path.parent for path in Path(__file__).parents[1].glob("results/*/checkpoint.pt"))


@pytest.mark.parametrize("run", RUNS, ids=lambda run: run.name)
def test_a_published_run_loads_and_rides(run):
    config, _, networks, _ = load_run(run, num_envs=1)
    make = partial(make_env, config, **DEPLOYMENT_OVERRIDES)
    result = evaluate_tracking(
        networks.deployed_policy(), make, ([-1.0, 1.0], [0.0]), 12, seconds=4.0, settle=3.0, seed=7
    )
    assert result.survived.mean() > 0.8
    backward, forward = result.settled_speed.mean((1, 2))
    assert backward < -0.7  # with sensors as robots have them, a straight ride does not show its speed
    assert forward > 0.7
    assert not any("privileged" in name for name in result.policy_reads)


def test_something_is_published():
    assert RUNS

"""A policy that has not been trained, and jobs that keep what they measure."""

from __future__ import annotations

from pathlib import Path

import pytest

from torchrl_atr.reproduction.parts import Parts
from torchrl_atr.reproduction.policies import RiderPolicy, load_rider
from torchrl_atr.reproduction.report import Job
from torchrl_atr.training import Trainer, make_config

TINY = {
    "env.num_envs": 2,
    "ppo.rollout_steps": 2,
    "ppo.minibatches": 1,
    "ppo.actor_cells": [8],
    "ppo.critic_cells": [8],
    "total_frames": 4,
    "compute.num_threads": 1,
    "logging.logger": "csv",
}


@pytest.fixture(scope="session")
def untrained_run(tmp_path_factory) -> Path:
    """The folder of a run that has not begun; only to be read."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    Trainer(make_config(TINY), folder).save()
    return folder


@pytest.fixture(scope="session")
def untrained(untrained_run) -> RiderPolicy:
    return load_rider(untrained_run)


@pytest.fixture
def job(untrained, tmp_path) -> Job:
    return Job([untrained], Parts(tmp_path / "parts"), "torchrl-atr reproduce figure", quick=True)

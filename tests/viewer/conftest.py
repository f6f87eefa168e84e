"""A run that was never trained, and the committed one."""

from __future__ import annotations

from pathlib import Path

import pytest

from torchrl_atr.training import Trainer, make_config
from torchrl_atr.viewer import Session, Setup

TINY = {
    "env.num_envs": 2,
    "total_frames": 8,
    "ppo.rollout_steps": 2,
    "ppo.minibatches": 1,
    "compute.num_threads": 1,
    "ppo.actor_cells": (16,),
    "ppo.critic_cells": (16,),
}


@pytest.fixture(scope="session")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    Trainer(make_config(TINY), folder).save()
    return folder


@pytest.fixture
def session(run) -> Session:
    return Session(Setup(run))


@pytest.fixture(scope="session")
def trained() -> Path:
    return Path(__file__).parents[2] / "results" / "a1-single_board"

"""The learner on a GPU, physics on the CPU; runs where there is one."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.training import Trainer, load_checkpoint, load_run, make_config, run_config

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device; torch finds none here")
SETTINGS = {"num_envs": 8, "rollout_steps": 8, "total_frames": 3 * 64, "num_threads": 1, "device": "cuda"}


def test_it_trains_there_and_goes_on_and_rides_without_it(tmp_path):
    metrics = []
    trainer = Trainer(make_config(SETTINGS), tmp_path / "run")
    trainer.train(metrics.append)
    assert {parameter.device.type for parameter in trainer.learner.networks.parameters()} == {"cuda"}
    assert trainer.env.base_env.device.type == "cpu"
    assert all(torch.isfinite(torch.tensor(list(m.values()))).all() for m in metrics)
    _, env, networks, _ = load_run(tmp_path / "run", num_envs=2)
    assert env.rollout(3, networks.deployed_policy())["action"].device.type == "cpu"
    state = load_checkpoint(tmp_path / "run")
    resumed = Trainer(run_config(state, tmp_path, device="cpu", total_frames=4 * 64), tmp_path / "run", state)
    assert resumed.train() is None
    assert resumed.frames == 4 * 64

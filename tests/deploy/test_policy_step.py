"""The step that is exported acts as the policy in its env, for every kind of dead reckoning and history."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import torchrl_atr
from torchrl_atr.deploy.episode import record
from torchrl_atr.deploy.policy_step import SENSORS, STATE, PolicyStep
from torchrl_atr.modules import CommandRange
from torchrl_atr.training import Trainer, load_run, make_config

TINY = {"env.num_envs": 2, "total_frames": 8, "ppo.rollout_steps": 2, "ppo.minibatches": 1, "compute.num_threads": 1}
OTHERS = [
    {"task.velocity_filter": "integral", "task.interpretation.current_in_history": True},
    {
        "task.velocity_filter": "leaky_integral",
        "task.interpretation.gravity_in_acceleration": True,
        "preset": "concurrent",
    },
    {"preset": "asymmetric", "env.history_length": 3, "task.transporter": "two_board"},
]


@pytest.mark.parametrize("settings", OTHERS)
def test_it_acts_as_the_policy_does_in_its_env(tmp_path, settings):
    Trainer(make_config({**TINY, **settings}), tmp_path).save()
    limits = CommandRange(2.0, 1.0, 0.5)
    limits.save(tmp_path)
    config, env, networks, _ = load_run(tmp_path, num_envs=2)
    base = env.base_env
    step = PolicyStep(networks, base.task, base.scene, config.task.velocity_filter, limits).eval()
    recorded = record(torchrl_atr.load_policy(tmp_path), steps=120)
    episode = {name: torch.from_numpy(value) for name, value in recorded.items()}
    assert episode["start"][1:].any()
    history = torch.full(env.observation_spec["history"].shape, torch.nan)  # whatever it is: episodes start first
    state = {"history": history, "dead_reckoning": step.rest.expand(2, -1), "last_action": torch.zeros(2, 12)}
    errors = []
    for t in range(len(episode["start"])):
        readings = {name: episode[name][t] for name in (*SENSORS, "command")}
        with torch.no_grad():
            out = step(start=episode["start"][t].unsqueeze(-1), **readings, **state)
        state = {name: getattr(out, source) for name, source in STATE.items()}
        errors.append((out.action - episode["action"][t]).abs().max().item())
    assert np.max(errors) < 1e-4

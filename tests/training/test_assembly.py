"""The env that a configuration describes, in training and deployed."""

from __future__ import annotations

import torch

from torchrl_atr.training import DEPLOYED, make_config, make_env
from torchrl_atr.training.assembly import TOGETHER

CONFIG = make_config({"num_envs": 64, "max_speed": 3.0, "max_yaw_rate": 1.0, "num_threads": 1})


def test_training_starts_at_staggered_times_and_within_the_bounds():
    env = make_env(CONFIG)
    assert env.curriculum.grid.bounds == (3.0, 1.0)
    assert env.reset()["step_count"].unique().numel() > 8


def test_robots_reach_their_time_limits_together():
    short = {"episode_seconds": 0.4, "command_seconds": 0.4, "score_from_seconds": 0.0}
    data = make_env(make_config({**short, "num_envs": 16, "num_threads": 1})).rollout(60, break_when_any_done=False)
    ends = data["next", "truncated"].squeeze(-1).any(0).nonzero().squeeze(-1) + 1
    assert len(ends) > 2
    assert not (ends % TOGETHER).any()


def test_a_deployed_policy_starts_at_the_beginning_and_takes_any_command():
    env = make_env(CONFIG, num_envs=2, **DEPLOYED)
    env.curriculum.pin(torch.tensor([15.0, -2.0]))
    start = env.reset()
    assert start["command"].tolist() == [[15.0, -2.0]] * 2
    assert not start["step_count"].any()

"""Robots that start together do not end together."""

from __future__ import annotations

import torch
from torchrl.envs import SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.testing.mocking_classes import CountingBatchedEnv, CountingEnv

from torchrl_atr.envs.transforms import StaggeredCounter

LIMIT, ENVS = 10, 64


def env() -> TransformedEnv:
    endless = CountingBatchedEnv(max_steps=torch.full((ENVS,), 10**6), batch_size=[ENVS])
    return TransformedEnv(endless, StaggeredCounter(LIMIT, seed=0))


def test_first_episodes_end_anywhere_and_later_ones_last_their_time():
    done = env().rollout(3 * LIMIT, break_when_any_done=False)["next", "done"].squeeze(-1)
    first = done.int().argmax(-1)
    assert set(first.tolist()) == set(range(LIMIT))
    for row, start in zip(done, first.tolist()):
        assert row.nonzero().squeeze(-1).tolist() == list(range(start, 3 * LIMIT, LIMIT))


def test_each_env_of_a_serial_one_draws_its_own():
    several = SerialEnv(8, lambda: TransformedEnv(CountingEnv(max_steps=10**6), StaggeredCounter(LIMIT)))
    assert len(set(several.reset()["step_count"].flatten().tolist())) > 1


def test_specs():
    check_env_specs(env())

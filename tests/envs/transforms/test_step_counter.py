"""Robots that start together do not end together."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs import SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.testing.mocking_classes import CountingBatchedEnv, CountingEnv

from torchrl_atr._errors import InputError
from torchrl_atr.envs.transforms import RandomizedStepCounter, TimeLimitGrowth, task_transforms

LIMIT, ENVS = 10, 64


def env(check_interval: int = 1, growth: TimeLimitGrowth | None = None) -> TransformedEnv:
    endless = CountingBatchedEnv(max_steps=torch.full((ENVS,), 10**6), batch_size=[ENVS])
    return TransformedEnv(endless, RandomizedStepCounter(LIMIT, seed=0, check_interval=check_interval, growth=growth))


def ends(check_interval: int) -> torch.Tensor:
    """When episodes end, (ENVS, steps) bool."""
    return env(check_interval).rollout(5 * LIMIT, break_when_any_done=False)["next", "truncated"].squeeze(-1)


def ride(env, data, steps):
    """Step on from ``data``; return when episodes end, (ENVS, steps) bool, and the last data."""
    ends = []
    for _ in range(steps):
        stepped, data = env.step_and_maybe_reset(env.rand_action(data))
        ends.append(stepped["next", "truncated"])
    return torch.cat(ends, -1), data


def test_first_episodes_end_anywhere_and_later_ones_last_their_time():
    done = env().rollout(3 * LIMIT, break_when_any_done=False)["next", "done"].squeeze(-1)
    first = done.int().argmax(-1)
    assert set(first.tolist()) == set(range(LIMIT))
    for row, start in zip(done, first.tolist()):
        assert row.nonzero().squeeze(-1).tolist() == list(range(start, 3 * LIMIT, LIMIT))


@pytest.mark.parametrize("check_interval", [4, 7, 16])
def test_episodes_end_together_at_the_first_multiple_from_the_limit_on(check_interval):
    for row, each_step in zip(ends(check_interval), ends(1)):
        found = row.nonzero().squeeze(-1) + 1
        first = int(each_step.int().argmax()) + 1
        wanted = [-(-first // check_interval) * check_interval]  # rounded up
        while wanted[-1] + LIMIT <= 5 * LIMIT:
            wanted.append(-(-(wanted[-1] + LIMIT) // check_interval) * check_interval)
        assert found.tolist() == [step for step in wanted if step <= 5 * LIMIT]


def test_done_follows_truncated_at_every_step():
    data = env(check_interval=4).rollout(3 * LIMIT, break_when_any_done=False)["next"]
    assert data["truncated"].any()
    assert torch.equal(data["done"], data["truncated"])


def test_a_restored_state_goes_on_at_the_same_phase():
    original, restored = env(check_interval=4), env(check_interval=4)
    _, data = ride(original, original.reset(), 6)
    restored.reset()
    restored.transform.load_state_dict(original.transform.state_dict())
    goes_on, _ = ride(restored, data.clone(), 3 * LIMIT)
    wanted, _ = ride(original, data.clone(), 3 * LIMIT)
    assert wanted.any()
    assert torch.equal(goes_on, wanted)


def test_a_limit_grows_geometrically_between_two_steps():
    growth = TimeLimitGrowth(first=2, begin=20, end=60)
    assert [growth.limit(step, 32) for step in (0, 20, 30, 40, 50, 60, 10**9)] == [2, 2, 4, 8, 16, 32, 32]
    assert TimeLimitGrowth(first=2, begin=20, end=20).limit(19, 32) == 2


def test_episodes_become_longer_where_the_limit_grows():
    data = env(growth=TimeLimitGrowth(first=2, begin=20, end=40)).rollout(80, break_when_any_done=False)["next"]
    lengths = torch.where(data["truncated"], data["step_count"], 0).squeeze(-1)
    assert set(lengths[:, :20].unique().tolist()) == {0, 2}
    growing = lengths[:, 20:40].amax(0)
    assert growing[growing > 0].diff().min() >= 0
    assert set(lengths[:, 50:].unique().tolist()) == {0, LIMIT}


def test_a_share_of_the_episodes_keeps_the_first_limit():
    growth = TimeLimitGrowth(first=2, begin=0, end=0, kept=0.6)
    data = env(growth=growth).rollout(2000, break_when_any_done=False)["next"]
    ends = data["step_count"][data["truncated"]][100:]
    assert set(ends.tolist()) == {2, LIMIT}
    assert (ends == 2).float().mean().item() == pytest.approx(0.6, abs=0.03)


@pytest.mark.parametrize("kept", [0.0, 0.5])
def test_a_restored_env_has_the_limits_that_it_had(kept):
    growth = TimeLimitGrowth(first=2, begin=20, end=40, kept=kept)
    original, restored = env(growth=growth), env(growth=growth)
    _, data = ride(original, original.reset(), 30)
    restored.reset()
    restored.transform.load_state_dict(original.transform.state_dict())
    assert 2 < restored.transform.limit == original.transform.limit < LIMIT
    goes_on, wanted = (ride(each, data.clone(), 3 * LIMIT)[0] for each in (restored, original))
    assert wanted.any()
    assert torch.equal(goes_on, wanted)


@pytest.mark.parametrize("check_interval", [0, -3])
def test_impossible_multiples_are_refused(check_interval):
    with pytest.raises(ValueError, match=f"check_interval must be at least 1, got {check_interval}"):
        RandomizedStepCounter(LIMIT, check_interval=check_interval)


@pytest.mark.parametrize(
    ("growth", "words"),
    [
        (TimeLimitGrowth(0, 1, 2), "growth.first=0"),
        (TimeLimitGrowth(LIMIT + 1, 1, 2), f"growth.first={LIMIT + 1}"),
        (TimeLimitGrowth(1, 3, 2), "growth.end=2"),
        (TimeLimitGrowth(1, 2, 3, 7.0), "growth.kept=7.0"),
    ],
)
def test_impossible_growth_is_named(growth, words):
    with pytest.raises(InputError, match=words):
        env(growth=growth)


def test_a_growing_limit_needs_staggered_starts():
    with pytest.raises(InputError, match="give stagger=1 or more"):
        task_transforms((1.0, 1.0), time_limit_growth=TimeLimitGrowth(1, 2, 3))


def test_each_env_of_a_serial_one_draws_its_own():
    several = SerialEnv(8, lambda: TransformedEnv(CountingEnv(max_steps=10**6), RandomizedStepCounter(LIMIT)))
    assert len(set(several.reset()["step_count"].flatten().tolist())) > 1


def test_specs():
    check_env_specs(env())

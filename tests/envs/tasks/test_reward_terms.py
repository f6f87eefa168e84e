"""Reward terms as data: their sum, its scale and its clipping, and that one which cannot be used is named."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.tasks import RIDING_REWARDS
from torchrl_atr.envs.tasks.reward_terms import RewardError, RewardFunction, RewardTerm

TRACKING = ("forward_command", "steering_command")


def reward_function(context, terms=RIDING_REWARDS, **interpretation):
    context.interpretation = Interpretation(**interpretation)
    return RewardFunction(terms, context, TRACKING)


@pytest.mark.parametrize(("times_dt", "scale"), [(False, 1.0), (True, 0.02)])
def test_terms_are_scaled_and_add_up(make_context, times_dt, scale):
    context = make_context(terminated=True, speeds=[0.4, 0.0], position=[0.2, 0.0, 0.4])
    rewards = reward_function(context, rewards_times_dt=times_dt)
    reward, terms = rewards(context)
    assert reward.shape == (1, 1)
    assert torch.equal(reward, terms.sum(0))
    for value, term in zip(terms, RIDING_REWARDS.values(), strict=True):
        torch.testing.assert_close(value, scale * term(context).unsqueeze(-1))
    assert rewards.tracking_max == {"forward_command": 8.0 * scale, "steering_command": 8.0 * scale}
    assert rewards.termination_cost == -10.0 * scale


def test_clipping_cuts_the_sum_at_zero_and_adds_termination_after(make_context):
    bad = {"com": [3.0, 0.0, 0.455]}  # -90 for the alignment
    for situation, expected in (
        (bad, 0.0),
        ({**bad, "terminated": True}, -10.0),
        ({}, 16.0),
        ({"terminated": True}, 6.0),
    ):
        context = make_context(**situation)
        reward, _ = reward_function(context, positive_rewards=True, rewards_times_dt=False)(context)
        assert reward.item() == pytest.approx(expected, abs=1e-4)


def test_without_a_termination_term_nothing_but_the_sum_is_clipped(make_context):
    terms = {"slow": RewardTerm(lambda c: c.state.speeds[:, 0].abs(), -1.0)}
    context = make_context(speeds=[0.4, 0.0], terminated=True)
    rewards = reward_function(context, terms, positive_rewards=True)
    assert rewards(context)[0].item() == 0.0
    assert rewards.termination_cost == 0.0
    assert rewards.tracking_max == dict.fromkeys(TRACKING, 0.0)


def test_rewards_are_float32_whatever_a_function_returns(make_context):
    terms = {"double": RewardTerm(lambda c: c.action.sum(-1).double() + 1.0, 0.5), "half": RewardTerm(half, 1.0)}
    reward, each = reward_function(make_context(), terms, rewards_times_dt=False)(make_context())
    assert reward.dtype == each.dtype == torch.float32
    assert each.flatten().tolist() == [0.5, 2.0]


def half(c):
    return torch.full((len(c.action),), 2.0, dtype=torch.float16)


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({}, "give a mapping of names to RewardTerm"),
        ([1], "give a mapping of names to RewardTerm"),
        ({"quiet": lambda c: c.action.sum(-1)}, "the reward term 'quiet' is <function"),
        (
            {"quiet": RewardTerm(lambda c: c.action, 1.0)},
            r"'quiet' returned \(1, 12\) of float32; it must return floats of shape \(1,\)",
        ),
        ({"quiet": RewardTerm(lambda c: c.terminated, 1)}, r"'quiet' returned \(1,\) of int64; it must return floats"),
        ({"quiet": RewardTerm(lambda c: 1.0, 1.0)}, "'quiet' returned float"),
        ({"quiet": RewardTerm(lambda c: c.state.nose, 1.0)}, "'quiet' failed: AttributeError: .*nose"),
    ],
)
def test_a_term_that_cannot_be_used_is_named(make_context, terms, message):
    with pytest.raises(RewardError, match=message):
        reward_function(make_context(), terms)


@pytest.mark.parametrize("weight", ["1", None, True, float("nan"), float("inf"), 10**400])
def test_a_weight_is_a_finite_number(weight):
    with pytest.raises(RewardError, match="is no finite number"):
        RewardTerm(lambda c: c.action, weight)
    with pytest.raises(RewardError, match="cannot be called"):
        RewardTerm("action", 1.0)

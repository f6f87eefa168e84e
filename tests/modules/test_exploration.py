"""Correlated exploration: the marginal and the log-probability of the policy, and noise that lasts."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchrl_atr.modules import CorrelatedGaussian


def sample(explore: CorrelatedGaussian, steps: int, rows: int = 2000) -> torch.Tensor:
    loc, scale = torch.full((rows, 2), 3.0), torch.tensor([0.5, 2.0]).expand(rows, 2)
    with set_exploration_type(ExplorationType.RANDOM):
        return torch.stack(
            [explore(TensorDict(loc=loc, scale=scale, batch_size=[rows]))["action"] for _ in range(steps)]
        )


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_marginal_and_correlation(correlation):
    torch.manual_seed(0)
    actions = sample(CorrelatedGaussian(correlation), 12)
    noise = (actions - 3.0) / torch.tensor([0.5, 2.0])
    assert abs(float(noise[-1].mean())) < 0.05
    assert float(noise[-1].std()) == pytest.approx(1.0, abs=0.03)
    for lag in (1, 5):
        measured = float((noise[-1] * noise[-1 - lag]).mean())
        assert measured == pytest.approx(correlation**lag, abs=0.04)


def test_log_probability_is_the_marginal_one():
    torch.manual_seed(0)
    explore, loc, scale = CorrelatedGaussian(0.9), torch.randn(5, 3), torch.rand(5, 3) + 0.1
    with set_exploration_type(ExplorationType.RANDOM):
        for _ in range(3):
            td = explore(TensorDict(loc=loc, scale=scale, batch_size=[5]))
    expected = torch.distributions.Normal(loc, scale).log_prob(td["action"]).sum(-1)
    assert torch.allclose(td["action_log_prob"], expected)


def test_deterministic_is_the_mean():
    loc = torch.randn(5, 3)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = CorrelatedGaussian(0.9)(TensorDict(loc=loc, scale=torch.ones(5, 3), batch_size=[5]))
    assert torch.equal(td["action"], loc)


def test_bad_correlation():
    with pytest.raises(ValueError, match=r"correlation must be in \[0, 1\), got 1"):
        CorrelatedGaussian(1.0)

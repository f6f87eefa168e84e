"""The loss of an estimate: squared errors, or a likelihood."""

from __future__ import annotations

import math

import pytest
import torch
from torch.distributions import Normal

from torchrl_atr.objectives.regression import regression


def test_a_likelihood_is_that_of_a_normal_distribution_in_units_of_the_target():
    estimate, target, scale = torch.randn(7, 3), torch.randn(7, 3), torch.rand(7, 3) + 0.1
    unit = torch.tensor([1.0, 2.0, 0.5])
    loss, error, calibration = regression(estimate, target, unit, scale)
    wanted = -Normal(estimate / unit, scale / unit).log_prob(target / unit).sum(-1) - 1.5 * math.log(2 * math.pi)
    torch.testing.assert_close(loss, wanted)
    torch.testing.assert_close(error, (estimate - target) / unit)
    torch.testing.assert_close(calibration, ((estimate - target) / scale).square().mean().sqrt())


def test_the_likelihood_is_best_where_the_scale_is_the_error():
    estimate, target = torch.full((200_000, 1), 0.3), torch.randn(200_000, 1)
    raw = torch.zeros(1, requires_grad=True)
    scales = torch.linspace(0.8, 1.4, 61)
    losses = [float(regression(estimate, target, None, each.expand_as(target))[0].mean()) for each in scales]
    assert float(scales[losses.index(min(losses))]) == pytest.approx(math.sqrt(1 + 0.3**2), abs=0.02)
    regression(estimate, target, None, raw.exp().expand_as(target))[0].mean().backward()
    assert float(raw.grad) == pytest.approx(1 - (1 + 0.3**2), abs=0.02)


def test_without_a_scale_it_is_the_squared_error():
    estimate, target = torch.randn(7, 3), torch.randn(7, 3)
    loss, _, calibration = regression(estimate, target)
    torch.testing.assert_close(loss, (estimate - target).square().sum(-1))
    assert calibration is None

"""The actor's inputs beyond Table I: products of observations."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.modules import ActorBackbone, RunningNormalizer
from torchrl_atr.modules.actor import PRODUCT_SCALE


def backbone(products: list[tuple[int, int]]) -> ActorBackbone:
    torch.manual_seed(0)
    return ActorBackbone(RunningNormalizer(3), RunningNormalizer(1), 1, 2, cells=(), products=products)


def test_a_product_is_one_more_input_with_the_sign_of_both():
    """Without hidden layers the mean is linear in its inputs: the product's column is what is not odd."""
    actor = backbone([(1, 2)])
    (layer,) = [module for module in actor.net if isinstance(module, torch.nn.Linear)]
    assert layer.in_features == 3 + 1 + 1 + 1
    x = torch.tensor([[0.0, 0.5, -2.0]])
    rest = torch.zeros(1, 1)
    mean = actor(x, rest, rest)[0] + actor(-x, rest, rest)[0] - 2 * actor(0 * x, rest, rest)[0]
    gated = PRODUCT_SCALE * torch.tanh(torch.tensor(0.5)) * -2.0
    expected = 2 * (layer.weight[:, 3] * gated) @ actor.head
    torch.testing.assert_close(mean[0], expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("pair", [(0, 3), (-1, 0)])
def test_products_beyond_the_observation_are_refused(pair):
    with pytest.raises(ValueError, match="names entries beyond the observation's 3"):
        backbone([pair])

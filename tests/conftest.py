"""Small networks that the tests of modules and objectives share; no size is the paper's."""

from __future__ import annotations

import pytest
import torch
from torchrl.data import Composite, Unbounded

from torchrl_atr.modules import ROANetworks, make_networks


@pytest.fixture
def spec() -> Composite:
    """A batched observation spec (5 robots) whose sizes are not the paper's."""
    return Composite(
        observation=Unbounded((5, 7)),
        history=Unbounded((5, 4, 7)),
        privileged=Composite(intrinsic=Unbounded((5, 6)), extrinsic=Unbounded((5, 3)), shape=(5,)),
        shape=(5,),
    )


@pytest.fixture
def networks(spec: Composite) -> ROANetworks:
    torch.manual_seed(0)
    nets = make_networks(spec, Unbounded((5, 2)), latent_features=4, actor_cells=(16,), critic_cells=(16,))
    nets.update_normalizers(spec.rand() * 3 + 1)
    return nets

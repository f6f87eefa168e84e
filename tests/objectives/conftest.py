from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchrl_atr.modules import ROANetworks
from torchrl_atr.objectives import ROAClipPPOLoss


@pytest.fixture
def make_loss(networks: ROANetworks) -> Callable[..., ROAClipPPOLoss]:
    def make(source: str = "privileged", **kwargs) -> ROAClipPPOLoss:
        return ROAClipPPOLoss(
            networks.training_actor(source),
            networks.critic_module,
            networks.encoder_module,
            networks.intrinsic_estimator_module,
            networks.extrinsic_estimator_module,
            **kwargs,
        )

    return make


@pytest.fixture
def make_batch(spec: Composite, networks: ROANetworks) -> Callable[..., TensorDictBase]:
    """A [5, 6] rollout on random data: stored actions, log-probabilities and whatever the source records."""

    def make(source: str = "privileged", steps: int = 6) -> TensorDictBase:
        torch.manual_seed(1)
        policy = networks.rollout_policy(source, 0.4)
        with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            frames = [policy(spec.rand()) for _ in range(steps)]
        td = torch.stack(frames, 1).exclude("latent", ("act", "intrinsic"), ("act", "extrinsic"))
        flag = torch.zeros(5, steps, 1, dtype=torch.bool)
        done = flag.clone()
        done[2, 3] = True
        td["next"] = TensorDict(
            observation=torch.randn(5, steps, 7),
            privileged=TensorDict(
                intrinsic=torch.randn(5, steps, 6), extrinsic=torch.randn(5, steps, 3), batch_size=(5, steps)
            ),
            reward=torch.randn(5, steps, 1),
            done=done,
            terminated=done.clone(),
            truncated=flag,
            batch_size=(5, steps),
        )
        td.refine_names(None, "time")
        return td

    return make

"""Distillation as a loss of its own in TorchRL: what it reads, returns and trains."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.objectives import DistillationLoss


@pytest.fixture
def loss(networks):
    return DistillationLoss(
        networks.training_actor("privileged"),
        networks.critic_module,
        networks.encoder_module,
        networks.intrinsic_estimator_module,
        networks.extrinsic_estimator_module,
        functional=False,
    )


def test_its_forward_is_imitation_and_adaptation(loss, make_batch):
    data = make_batch().flatten()
    data["teacher_mean"] = torch.randn_like(data["action"])
    terms = loss(data)
    named = set(map(str, terms.keys()))
    assert {key for key in named if key.startswith("loss_")} == {
        "loss_imitation",
        "loss_intrinsic",
        "loss_extrinsic",
    }
    assert set(loss.out_keys) == named
    assert "teacher_mean" in loss.in_keys
    read = data.select(*loss.in_keys, strict=False)
    torch.testing.assert_close(loss(read)["loss_imitation"], terms["loss_imitation"])


def test_nothing_of_ppo_is_trained(loss, networks, make_batch):
    data = make_batch().flatten()
    data["teacher_mean"] = torch.randn_like(data["action"])
    terms = loss(data)
    sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
    assert all(parameter.grad is None for parameter in networks.critic.parameters())
    assert all(parameter.grad is None for parameter in networks.exploration.parameters())
    assert any(parameter.grad is not None for parameter in networks.backbone.parameters())

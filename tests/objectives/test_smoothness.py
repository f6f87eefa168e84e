"""The pull of the mean action towards that of the step before."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.objectives import previous_means


def with_previous(batch):
    batch["previous_mean"] = previous_means(batch["loc"], batch["next", "done"])
    return batch


@pytest.mark.parametrize("functional", [True, False])
@pytest.mark.parametrize("method", ["forward", "policy_loss"])
def test_it_is_the_squared_change_of_the_mean(make_loss, make_batch, functional, method):
    batch = with_previous(make_batch())
    loss = make_loss(smoothness_coeff=0.5, functional=functional)
    out = getattr(loss, method)(batch)
    # nothing has moved since the rollout: the means are those that it recorded
    expected = 0.5 * (batch["loc"] - batch["previous_mean"]).square().sum(-1).mean()
    torch.testing.assert_close(out["loss_smoothness"], expected)
    assert "loss_smoothness" in loss.out_keys
    assert "previous_mean" in loss.in_keys


def test_its_gradient_is_the_actors(networks, make_loss, make_batch):
    batch = with_previous(make_batch())
    make_loss(smoothness_coeff=1.0, functional=False).policy_loss(batch)["loss_smoothness"].backward()
    assert all(p.grad is None for p in networks.critic.parameters())
    assert any(p.grad is not None and p.grad.any() for p in networks.backbone.parameters())
    assert any(p.grad is not None and p.grad.any() for p in networks.encoder.parameters())


def test_without_it_nothing_is_asked_of_the_data(make_loss, make_batch):
    loss = make_loss()
    assert "loss_smoothness" not in set(loss(make_batch()).keys())
    assert "loss_smoothness" not in loss.out_keys
    assert "previous_mean" not in loss.in_keys


def test_data_without_it_are_refused_by_name(make_loss, make_batch):
    with pytest.raises(KeyError, match="smoothness_coeff needs 'previous_mean' in the data"):
        make_loss(smoothness_coeff=1.0)(make_batch())


def test_the_key_can_be_renamed(make_loss, make_batch):
    batch = with_previous(make_batch())
    batch.rename_key_("previous_mean", "earlier")
    loss = make_loss(smoothness_coeff=1.0)
    loss.set_keys(previous_mean="earlier")
    assert loss(batch)["loss_smoothness"] > 0


def test_a_step_with_nothing_before_it_pulls_nowhere():
    means = torch.randn(3, 5, 2)
    done = torch.zeros(3, 5, 1, dtype=torch.bool)
    done[1, 2] = True
    before = previous_means(means, done)
    assert torch.equal(before[:, 0], means[:, 0])
    assert torch.equal(before[1, 3], means[1, 3])
    assert torch.equal(before[0, 1:], means[0, :-1])
    assert torch.equal(before[1, 4], means[1, 3])

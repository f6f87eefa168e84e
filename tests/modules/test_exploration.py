"""Exploration: its size, its directions, and noise that lasts with the policy's own marginal and log-probability."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch.distributions import kl_divergence
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import IndependentNormal, ProbabilisticActor

from torchrl_atr.modules import (
    ActorBackbone,
    CorrelatedGaussian,
    Exploration,
    RotatedNormal,
    RunningNormalizer,
    hadamard_leg_basis,
    make_actor,
    with_correlated_noise,
)

INPUTS = torch.zeros(1, 5), torch.zeros(1, 3), torch.zeros(1, 4)


def backbone(actions: int = 2) -> ActorBackbone:
    torch.manual_seed(0)
    return ActorBackbone(RunningNormalizer(5), RunningNormalizer(4), 3, actions)


@pytest.mark.parametrize("raw", [-50.0, -5.0, 5.0])
def test_std_keeps_its_floor_and_a_gradient_near_it(raw):
    exploration = Exploration(1, 0.3, 0.05)
    with torch.no_grad():
        exploration.raw.fill_(raw)
    value = exploration.std()
    assert value.item() >= 0.05
    value.sum().backward()
    assert exploration.raw.grad.item() > 0


def test_a_cap_lowers_the_std_and_keeps_its_gradient():
    exploration = Exploration(3, [0.3, 0.2, 0.1], 0.05)
    exploration.cap_(0.2)
    torch.testing.assert_close(exploration.std(), torch.tensor([0.2, 0.2, 0.1]))
    exploration.std().sum().backward()
    assert (exploration.raw.grad > 0).all()
    with pytest.raises(ValueError, match=r"ceiling must be above min_std=0\.05, got 0\.05"):
        exploration.cap_(0.05)


def test_std_rejects_a_floor_above_the_start():
    with pytest.raises(ValueError, match=r"min_std=0\.4"):
        Exploration(2, init_std=0.3, min_std=0.4)


def test_the_exploration_does_not_scale_the_mean():
    """Neither at first nor later: the same weights give the same mean action."""
    td = TensorDict(observation=torch.randn(6, 5), act={"intrinsic": torch.randn(6, 3), "extrinsic": torch.randn(6, 4)})
    td.batch_size = [6]
    actor, small = backbone(), Exploration(2, [1.0, 0.3])
    means = [make_actor(actor, each).get_dist(td).mean for each in (Exploration(2, 0.1), small)]
    small.cap_(0.1)
    means.append(make_actor(actor, small).get_dist(td).mean)
    assert torch.equal(means[0], means[1])
    assert torch.equal(means[0], means[2])


def test_without_a_basis_each_action_is_explored_by_itself():
    actor = make_actor(backbone(), Exploration(2, [0.5, 0.1]))
    td = TensorDict(observation=INPUTS[0], act={"intrinsic": INPUTS[1], "extrinsic": INPUTS[2]}, batch_size=[1])
    value = torch.randn(1, 2)
    dist = actor.get_dist(td)
    expected = torch.distributions.Normal(dist.mean, torch.tensor([0.5, 0.1])).log_prob(value).sum(-1)
    torch.testing.assert_close(dist.log_prob(value), expected)
    assert Exploration(2).state_dict().keys() == {"raw"}


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


def test_noise_that_began_in_inference_mode_goes_on_outside():
    explore = CorrelatedGaussian(0.9)
    td = TensorDict(loc=torch.zeros(2, 1), scale=torch.ones(2, 1), batch_size=[2])
    with set_exploration_type(ExplorationType.RANDOM):
        with torch.inference_mode():
            explore(td.clone())
        assert explore(td.clone())["action"].shape == (2, 1)


@pytest.mark.parametrize("mapped", [False, True])
def test_a_foreign_actor_with_keys_of_its_own(mapped):
    keys = [("agent", "loc"), ("agent", "scale")]
    if mapped:
        keys = [("agent", "mean"), "deviation"]
    network = TensorDictModule(lambda x: (x, torch.ones_like(x)), ["x"], keys)
    in_keys = dict(zip(("loc", "scale"), keys)) if mapped else keys
    actor = ProbabilisticActor(network, in_keys, out_keys=["act"], distribution_class=IndependentNormal)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = with_correlated_noise(actor, 0.9)(TensorDict(x=torch.full((2, 1), 3.0), batch_size=[2]))
    assert td["act"].tolist() == [[3.0], [3.0]]


def test_bad_correlation():
    with pytest.raises(ValueError, match=r"correlation must be in \[0, 1\), got 1"):
        CorrelatedGaussian(1.0)


def test_synergies_are_orthonormal_and_the_first_ones_move_all_legs_alike():
    basis = hadamard_leg_basis(3)
    torch.testing.assert_close(basis.T @ basis, torch.eye(12))
    for joint in range(3):
        torch.testing.assert_close(basis[:, joint], torch.eye(3)[joint].repeat(4) / 2)
    assert basis[:, 3:].reshape(4, 3, 9).sum(0).abs().max() == 0.0  # the others do not


def test_synergy_normal_is_the_multivariate_normal_of_its_basis():
    torch.manual_seed(0)
    basis, loc, scale = hadamard_leg_basis(), torch.randn(4, 12), torch.rand(12) + 0.1
    normal = RotatedNormal(loc, scale.expand(4, 12), basis)
    covariance = basis @ scale.square().diag() @ basis.T
    reference = torch.distributions.MultivariateNormal(loc, covariance)
    value = torch.randn(4, 12)
    torch.testing.assert_close(normal.log_prob(value), reference.log_prob(value))
    torch.testing.assert_close(normal.entropy(), reference.entropy())
    torch.testing.assert_close(normal.variance, reference.variance)
    torch.testing.assert_close(normal.stddev, reference.stddev)
    assert torch.equal(normal.deterministic_sample, loc)
    other = RotatedNormal(loc.flip(0), 2 * scale.expand(4, 12), basis)
    theirs = torch.distributions.MultivariateNormal(loc.flip(0), 4 * covariance)
    torch.testing.assert_close(kl_divergence(normal, other), kl_divergence(reference, theirs))
    with pytest.raises(NotImplementedError, match="give both the same basis"):
        kl_divergence(normal, RotatedNormal(loc, scale.expand(4, 12)))
    wider = normal.expand((3, 4))
    torch.testing.assert_close(wider.log_prob(value), reference.log_prob(value).expand(3, 4))
    measured = torch.cov((normal.sample((20_000,)) - loc)[:, 0].T)
    torch.testing.assert_close(measured, covariance, atol=0.05, rtol=0.1)


def test_correlate_keeps_the_actors_distribution():
    torch.manual_seed(0)
    actor = make_actor(backbone(12), Exploration(12, [0.5] * 3 + [0.1] * 9, basis=hadamard_leg_basis()))
    td = TensorDict(observation=torch.randn(6, 5), act={"intrinsic": torch.randn(6, 3), "extrinsic": torch.randn(6, 4)})
    td.batch_size = [6]
    with set_exploration_type(ExplorationType.RANDOM), torch.no_grad():
        out = with_correlated_noise(actor, 0.9)(td)
    torch.testing.assert_close(out["action_log_prob"], actor.get_dist(td).log_prob(out["action"]))


@pytest.mark.parametrize("basis", [torch.ones(2, 2), torch.eye(3)])
def test_a_bad_basis_is_refused(basis):
    with pytest.raises(ValueError, match="needs 2 orthonormal columns of 2"):
        Exploration(2, basis=basis)

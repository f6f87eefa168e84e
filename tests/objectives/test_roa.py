from __future__ import annotations

from collections import Counter

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModule
from torch import nn
from torchrl.data import Unbounded
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.modules.distributions import IndependentNormal
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from torchrl_atr.modules import (
    ActorBackbone,
    AsymmetricCritic,
    IntrinsicEncoder,
    NetworkKeys,
    RunningNormalizer,
    make_networks,
)
from torchrl_atr.objectives import ROAClipPPOLoss

SOURCES = ["privileged", "estimated", "mixed"]
TERMS = {"loss_objective", "loss_entropy", "loss_critic", "loss_intrinsic", "loss_roa", "loss_extrinsic"}
POLICY = {"backbone", "exploration", "encoder", "critic"}


def losses_of(td) -> dict[str, torch.Tensor]:
    return {key: value for key, value in td.items() if key.startswith("loss_")}


def groups(networks) -> dict[str, list[nn.Parameter]]:
    named = ["encoder", "backbone", "exploration", "critic", "intrinsic_estimator", "extrinsic_estimator"]
    return {name: list(getattr(networks, name).parameters()) for name in named}


def touched(networks) -> set[str]:
    """The networks in which some parameter has a gradient that is not exactly zero."""
    return {
        name
        for name, parameters in groups(networks).items()
        if any(p.grad is not None and bool((p.grad != 0).any()) for p in parameters)
    }


@pytest.mark.parametrize("functional", [True, False])
@pytest.mark.parametrize(
    ("term", "source", "receives"),
    [
        ("loss_objective", "privileged", {"backbone", "exploration", "encoder"}),
        ("loss_objective", "mixed", {"backbone", "exploration", "encoder"}),
        ("loss_objective", "estimated", {"backbone", "exploration"}),
        ("loss_entropy", "privileged", {"exploration"}),
        ("loss_critic", "privileged", {"critic"}),
        ("loss_intrinsic", "privileged", {"intrinsic_estimator"}),
        ("loss_roa", "privileged", {"encoder"}),
        ("loss_roa", "estimated", {"encoder"}),
        ("loss_extrinsic", "privileged", {"extrinsic_estimator"}),
    ],
)
def test_gradients_reach_only_their_network(networks, make_loss, make_batch, functional, term, source, receives):
    loss = make_loss(source, functional=functional)
    loss(make_batch(source))[term].backward()
    assert touched(networks) == receives


@pytest.mark.parametrize(
    ("method", "terms", "receives"),
    [
        ("forward", TERMS, POLICY | {"intrinsic_estimator", "extrinsic_estimator"}),
        (
            "policy_loss",
            {"loss_objective", "loss_entropy", "loss_critic", "loss_roa"},
            POLICY,
        ),
        (
            "adaptation_loss",
            {"loss_intrinsic", "loss_extrinsic"},
            {"intrinsic_estimator", "extrinsic_estimator"},
        ),
    ],
)
def test_entry_points(networks, make_loss, make_batch, method, terms, receives):
    out = losses_of(getattr(make_loss(), method)(make_batch()))
    assert set(out) == terms
    assert all(value.shape == () for value in out.values())
    sum(out.values()).backward()
    assert touched(networks) == receives


@pytest.mark.parametrize("source", SOURCES)
def test_entry_points_agree(make_loss, make_batch, source):
    loss, batch = make_loss(source), make_batch(source)
    loss.value_estimator(batch)
    whole = losses_of(loss(batch))
    parts = losses_of(loss.policy_loss(batch)) | losses_of(loss.adaptation_loss(batch))
    assert set(parts) == set(whole)
    for key, value in whole.items():
        torch.testing.assert_close(parts[key], value, msg=key)


@pytest.mark.parametrize("functional", [True, False])
@pytest.mark.parametrize("method", ["forward", "policy_loss"])
@pytest.mark.parametrize("source", SOURCES)
def test_actor_and_encoder_run_once(monkeypatch, make_loss, make_batch, source, method, functional):
    """Whatever the terms read of them, the smoothness's mean action and the latent of ``loss_roa`` included."""
    loss, batch, runs = make_loss(source, functional=functional, smoothness_coeff=1.0), make_batch(source), Counter()
    loss.value_estimator(batch)
    batch["previous_mean"] = batch["loc"] + 1.0

    def counted(kind):
        forward = kind.forward

        def run(self, *inputs):
            runs[kind.__name__] += 1
            return forward(self, *inputs)

        return run

    for kind in (ActorBackbone, IntrinsicEncoder, AsymmetricCritic):
        monkeypatch.setattr(kind, "forward", counted(kind))
    sum(losses_of(getattr(loss, method)(batch)).values()).backward()
    assert runs == {"ActorBackbone": 1, "IntrinsicEncoder": 1, "AsymmetricCritic": 1}


def test_nothing_is_kept_from_a_pass(make_loss, make_batch):
    loss, batch = make_loss(smoothness_coeff=1.0, functional=False), make_batch()
    loss.value_estimator(batch)
    batch["previous_mean"] = batch["loc"]
    before = set(vars(loss))
    loss.policy_loss(batch)
    assert set(vars(loss)) == before
    assert not [name for name, value in vars(loss).items() if isinstance(value, torch.Tensor)]


def test_an_actor_that_samples_in_several_modules_is_refused(networks):
    actor = networks.training_actor()
    chain = ProbabilisticTensorDictSequential(actor, *actor.module, return_composite=True)
    parts = networks.critic_module, networks.encoder_module, networks.intrinsic_estimator_module
    with pytest.raises(TypeError, match="whose last module alone samples"):
        ROAClipPPOLoss(chain, *parts, networks.extrinsic_estimator_module)


@pytest.mark.parametrize("source", SOURCES)
def test_an_entry_point_reads_no_more_than_it_says(networks, make_loss, make_batch, source):
    loss, batch = make_loss(source), make_batch(source)
    loss.value_estimator(batch)
    if source == "privileged":  # does not record it
        networks.intrinsic_estimator_module(batch)
    batch["shifted_valid"] = torch.rand(5, 6) < 0.7
    for method, keys in ((loss.policy_loss, loss.policy_in_keys), (loss.adaptation_loss, loss.adaptation_in_keys)):
        whole, part = method(batch), method(batch.select(*keys, strict=False))
        assert set(part.keys()) == set(whole.keys())
        assert all(torch.equal(part[key], value) for key, value in whole.items())
    assert "history" not in loss.policy_in_keys


def fixed(value, key, source) -> TensorDictModule:
    """A network with one parameter whose output is constant."""

    class Constant(nn.Module):
        def __init__(self):
            super().__init__()
            self.value = nn.Parameter(torch.tensor(value))

        def forward(self, x):
            return self.value.expand(*x.shape[:-1], -1)

    return TensorDictModule(Constant(), in_keys=[source], out_keys=[key])


def hand_made(**kwargs) -> tuple[ROAClipPPOLoss, TensorDict]:
    """z = (1, 2), zhat = (4, -2), xhat = (1, 1, 1); x = 0 in one sample and (3, 1, -1) in the other."""
    actor = ProbabilisticActor(
        TensorDictModule(lambda x: (x, torch.ones_like(x)), in_keys=["obs"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    loss = ROAClipPPOLoss(
        actor,
        ValueOperator(nn.Linear(2, 1), in_keys=["obs"]),
        fixed([1.0, 2.0], ("latent", "intrinsic"), "obs"),
        fixed([4.0, -2.0], ("estimate", "intrinsic"), "obs"),
        fixed([1.0, 1.0, 1.0], ("estimate", "extrinsic"), "obs"),
        **kwargs,
    )
    data = TensorDict(
        obs=torch.zeros(2, 2),
        privileged=TensorDict(extrinsic=torch.tensor([[0.0, 0.0, 0.0], [3.0, 1.0, -1.0]]), batch_size=[2]),
        action=torch.zeros(2, 2),
        action_log_prob=torch.full((2,), -1.8378770664),  # log N(0; 0, 1), two dimensions
        advantage=torch.tensor([[1.0], [3.0]]),
        value_target=torch.zeros(2, 1),
        batch_size=[2],
    )
    return loss, data


def test_hand_computed_terms():
    loss, data = hand_made(roa_coeff=0.2, intrinsic_coeff=3.0, extrinsic_coeff=0.5)
    out = loss(data)
    assert out["loss_intrinsic"].item() == pytest.approx(3.0 * 25)  # (4 - 1)^2 + (-2 - 2)^2
    assert out["loss_roa"].item() == pytest.approx(0.2 * 25)
    assert out["loss_extrinsic"].item() == pytest.approx(0.5 * (3 + 8) / 2)  # sums: 1+1+1 and 4+0+4
    assert out["loss_objective"].item() == pytest.approx(-2.0, abs=1e-5)  # the ratio is one
    assert out["latent_error"].item() == pytest.approx(5.0)
    assert out["extrinsic_error"].item() == pytest.approx((11 / 6) ** 0.5)


def test_hand_computed_gradients():
    """d/dzhat ||zhat - sg z||^2 = 2 (zhat - z); d/dz lambda ||sg zhat - z||^2 = -2 lambda (zhat - z)."""
    loss, data = hand_made(roa_coeff=0.2, extrinsic_scale=torch.tensor([1.0, 2.0, 4.0]))
    sum(losses_of(loss(data)).values()).backward()
    zhat_z = torch.tensor([3.0, -4.0])
    grads = {name: p.grad for name, p in loss.named_parameters() if "module_value" in name or "value" in name}
    by_net = {name.split("_network")[0]: grad for name, grad in grads.items()}
    torch.testing.assert_close(by_net["intrinsic_estimator"], 2 * zhat_z)
    torch.testing.assert_close(by_net["encoder"], -2 * 0.2 * zhat_z)
    # mean over two samples of 2 (xhat - x) / std^2
    torch.testing.assert_close(by_net["extrinsic_estimator"], torch.tensor([-1.0, 0.25, 0.1875]))


def test_extrinsic_scale_by_tensor_and_by_running_std():
    norm = RunningNormalizer(3, eps=1e-12)
    norm.update(torch.tensor([[-1.0, -2.0, -4.0], [1.0, 2.0, 4.0]]))  # std 1, 2, 4
    expected = (1 + 1 / 4 + 1 / 16 + 4 + 0 + 4 / 16) / 2
    for scale in (torch.tensor([1.0, 2.0, 4.0]), norm):
        loss, data = hand_made(extrinsic_scale=scale)
        assert loss.adaptation_loss(data)["loss_extrinsic"].item() == pytest.approx(expected)
    norm.update(torch.tensor([[-100.0, -100.0, -100.0], [100.0, 100.0, 100.0]]))
    assert loss.adaptation_loss(data)["loss_extrinsic"].item() < expected / 100  # the std is read at every call


@pytest.mark.parametrize("source", SOURCES)
def test_first_minibatch_has_ratio_one(networks, make_loss, make_batch, source):
    """Even after an adaptation step: the actor reads the estimates that the rollout recorded."""
    loss, batch = make_loss(source), make_batch(source)
    loss.value_estimator(batch)
    optimizer = torch.optim.SGD(networks.estimator_parameters(), lr=0.1)
    sum(losses_of(loss.adaptation_loss(batch)).values()).backward()
    optimizer.step()
    out = loss.policy_loss(batch.reshape(-1)[::2])
    assert abs(out["max_ratio"].item() - 1) < 1e-4
    assert abs(out["mean_ratio"].item() - 1) < 1e-4
    assert out["ESS"].item() == pytest.approx(1.0, abs=1e-4)
    assert out["clip_fraction"].item() == 0


def test_normaliser_updates_reach_the_loss(networks, make_loss, make_batch):
    """Rollouts after an update and the functional loss use the same statistics: the ratio is one again."""
    loss, batch = make_loss(), make_batch()
    stale = batch.clone()
    networks.update_normalizers(batch * 5)
    fresh = make_batch()
    for td in (stale, fresh):
        td["advantage"], td["value_target"] = torch.ones(5, 6, 1), torch.zeros(5, 6, 1)
    assert abs(loss(fresh)["max_ratio"].item() - 1) < 1e-4
    assert abs(loss(stale)["max_ratio"].item() - 1) > 1e-2


@pytest.mark.parametrize("method", ["forward", "policy_loss", "adaptation_loss"])
@pytest.mark.parametrize("source", SOURCES)
def test_the_batch_is_left_as_it_is(make_loss, make_batch, source, method):
    loss, batch = make_loss(source), make_batch(source)
    loss.value_estimator(batch)
    before = batch.clone()
    getattr(loss, method)(batch)
    assert set(batch.keys(True, True)) == set(before.keys(True, True))
    assert bool((batch == before).all())


def test_policy_loss_reads_a_recorded_estimate(make_loss, make_batch):
    loss, batch = make_loss(roa_coeff=1.0), make_batch()
    loss.value_estimator(batch)
    computed = loss.policy_loss(batch)["loss_roa"]
    batch["estimate", "intrinsic"] = torch.zeros(5, 6, 4)
    with torch.no_grad():
        latent = loss._latent(batch)
    torch.testing.assert_close(loss.policy_loss(batch)["loss_roa"], latent.square().sum(-1).mean())
    assert not torch.allclose(computed, loss.policy_loss(batch)["loss_roa"])


def test_ppo_terms_are_those_of_clip_ppo(networks, make_loss, make_batch):
    batch = make_batch()
    stock = ClipPPOLoss(networks.training_actor(), networks.critic_module, clip_epsilon=0.1, entropy_coeff=0.02)
    loss = make_loss(clip_epsilon=0.1, entropy_coeff=0.02)
    loss.value_estimator(batch)
    with torch.no_grad():
        batch["action_log_prob"] += 0.3 * torch.randn(5, 6)  # ratios that clip
    expected, out = stock(batch), loss(batch)
    for key, value in expected.items():
        torch.testing.assert_close(out[key], value, msg=key)
    assert expected["clip_fraction"] > 0


def test_functional_and_stateful_losses_agree(networks, make_loss, make_batch):
    batch = make_batch()
    functional, stateful = make_loss(functional=True), make_loss(functional=False)
    functional.value_estimator(batch)
    one, other = losses_of(functional(batch)), losses_of(stateful(batch))
    assert set(one) == set(other) == TERMS
    for key, value in one.items():
        torch.testing.assert_close(other[key], value, msg=key)
    ids = {id(p) for p in networks.parameters()}
    for loss in (functional, stateful):
        parameters = [id(p) for p in loss.parameters()]
        assert len(parameters) == len(set(parameters))
        assert set(parameters) == ids


@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
def test_reduction(make_loss, make_batch, reduction):
    batch = make_batch()
    loss = make_loss(reduction=reduction)
    loss.value_estimator(batch)
    raw = losses_of(make_loss(reduction="none")(batch))
    out = losses_of(loss(batch))
    assert set(out) == TERMS
    for key, value in out.items():
        assert raw[key].shape == (5, 6), key
        expected = raw[key] if reduction == "none" else getattr(raw[key], reduction)()
        torch.testing.assert_close(value, expected, msg=key)


def test_masked_samples_do_not_count(make_loss, make_batch):
    loss, batch = make_loss(), make_batch()
    loss.value_estimator(batch)
    mask = torch.ones(5, 6, dtype=torch.bool)
    mask[:, 4:] = False
    masked = batch.clone()
    masked["collector"] = TensorDict(mask=mask, batch_size=(5, 6))
    out, expected = losses_of(loss(masked)), losses_of(loss(batch[:, :4]))
    for key, value in expected.items():
        torch.testing.assert_close(out[key], value, msg=key)


@pytest.mark.parametrize(
    "kind", [None, ValueEstimators.GAE, ValueEstimators.TD0, ValueEstimators.TD1, ValueEstimators.TDLambda]
)
def test_value_estimators(make_loss, make_batch, kind):
    loss, batch = make_loss(), make_batch()
    if kind is not None:
        loss.make_value_estimator(kind, gamma=0.9)
    without = losses_of(loss(batch))  # computes the advantage itself
    loss.value_estimator(batch)
    assert batch["advantage"].shape == (5, 6, 1)
    for key, value in losses_of(loss(batch)).items():
        torch.testing.assert_close(value, without[key], msg=key)


def test_state_dict_round_trip(spec, networks, make_loss, make_batch):
    loss, batch = make_loss(extrinsic_scale=networks.ext_norm), make_batch()
    loss.value_estimator(batch)
    loss.roa_coeff = 0.07
    saved = {key: value.clone() for key, value in loss.state_dict().items()}
    expected = losses_of(loss(batch))
    with torch.no_grad():
        for parameter in networks.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    loss.roa_coeff = 0.5
    assert not torch.allclose(loss(batch)["loss_roa"], expected["loss_roa"])
    loss.load_state_dict(saved)
    assert loss.roa_coeff.item() == pytest.approx(0.07)
    for key, value in losses_of(loss(batch)).items():
        assert torch.equal(value, expected[key]), key


@pytest.mark.parametrize(
    ("coeff", "term"),
    [("roa_coeff", "loss_roa"), ("intrinsic_coeff", "loss_intrinsic"), ("extrinsic_coeff", "loss_extrinsic")],
)
def test_coefficients_are_schedulable(make_loss, make_batch, coeff, term):
    loss, batch = make_loss(**{coeff: 0.5}), make_batch()
    buffer, before = getattr(loss, coeff), losses_of(loss(batch))
    setattr(loss, coeff, 0.25)
    after = losses_of(loss(batch))
    assert getattr(loss, coeff) is buffer
    torch.testing.assert_close(after[term], before[term] / 2)
    for key in TERMS - {term}:
        torch.testing.assert_close(after[key], before[key], msg=key)
    assert f"{coeff}" in loss.state_dict()


def test_renamed_keys(spec, make_loss, make_batch):
    """Every key of ours under another (nested) name gives the same values."""
    batch, loss = make_batch(), make_loss()
    state = loss.state_dict()
    loss.value_estimator(batch)
    expected = losses_of(loss(batch))
    keys = NetworkKeys(
        observation=("agent", "obs"),
        history=("agent", "window"),
        intrinsic="hidden",
        extrinsic=("agent", "truth"),
        latent="z",
        intrinsic_estimate=("agent", "z_hat"),
        extrinsic_estimate="x_hat",
        act_intrinsic="act_z",
        act_extrinsic=("agent", "act_x"),
        action=("agent", "target"),
        state_value=("agent", "value"),
    )
    renamed = TensorDict(batch_size=(5, 6))
    moves = {
        "observation": keys.observation,
        "history": keys.history,
        ("privileged", "intrinsic"): keys.intrinsic,
        ("privileged", "extrinsic"): keys.extrinsic,
        "action": keys.action,
        "action_log_prob": ("agent", "lp"),
        "advantage": ("gae", "adv"),
        "value_target": ("gae", "target"),
    }
    for old, new in moves.items():
        renamed[new] = batch[old]
    nets = make_networks(
        _renamed_spec(spec, keys),
        Unbounded((2,)),
        latent_features=4,
        actor_cells=(16,),
        critic_cells=(16,),
        keys=keys,
    )
    other = ROAClipPPOLoss(
        nets.training_actor(),
        nets.critic_module,
        nets.encoder_module,
        nets.intrinsic_estimator_module,
        nets.extrinsic_estimator_module,
    )
    other.load_state_dict(state)
    other.set_keys(
        **keys.for_loss() | {"sample_log_prob": ("agent", "lp")},
        advantage=("gae", "adv"),
        value_target=("gae", "target"),
    )
    assert {keys.history, keys.extrinsic, keys.intrinsic} <= set(other.in_keys)
    for key, value in losses_of(other(renamed)).items():
        torch.testing.assert_close(value, expected[key], msg=key)


def _renamed_spec(spec, keys):
    out = spec.empty()
    out[keys.observation], out[keys.history] = spec["observation"], spec["history"]
    out[keys.intrinsic], out[keys.extrinsic] = (
        spec["privileged", "intrinsic"],
        spec["privileged", "extrinsic"],
    )
    return out


def test_default_and_forwarded_keys(make_loss):
    loss = make_loss()
    assert loss.tensor_keys.latent == ("latent", "intrinsic")
    assert loss.tensor_keys.sample_log_prob == "action_log_prob"
    loss.make_value_estimator(ValueEstimators.GAE)
    loss.set_keys(advantage="adv", reward=("r", "sum"), done="stop")
    assert loss.value_estimator.tensor_keys.advantage == "adv"
    assert loss.value_estimator.tensor_keys.reward == ("r", "sum")
    loss.set_keys(extrinsic="truth")
    loss.set_keys(extrinsic=None)
    assert loss.tensor_keys.extrinsic == ("privileged", "extrinsic")
    with pytest.raises(ValueError, match="not an accepted tensordict key"):
        loss.set_keys(lattent="z")


def test_keys_in_and_out(make_loss, make_batch):
    loss = make_loss()
    assert {"history", ("privileged", "intrinsic"), ("privileged", "extrinsic")} <= set(loss.in_keys)
    assert set(loss.out_keys) >= TERMS | {"latent_error", "extrinsic_error"}
    assert set(loss.out_keys) <= set(loss(make_batch()).keys())


def test_without_tensordicts():
    loss, data = hand_made()
    expected = loss(data)
    loss.select_out_keys("loss_intrinsic", "loss_roa")
    out = loss(
        obs=data["obs"],
        privileged_extrinsic=data["privileged", "extrinsic"],
        action=data["action"],
        action_log_prob=data["action_log_prob"],
        next_obs=data["obs"],
        next_reward=torch.zeros(2, 1),
        next_done=torch.ones(2, 1, dtype=torch.bool),
        next_terminated=torch.ones(2, 1, dtype=torch.bool),
    )
    torch.testing.assert_close(out, (expected["loss_intrinsic"], expected["loss_roa"]))


def test_reset_parameters_recursive(networks, make_loss):
    loss = make_loss()
    before = {name: [p.clone() for p in parameters] for name, parameters in groups(networks).items()}
    loss.reset_parameters_recursive()
    for name, parameters in groups(networks).items():
        changed = [not torch.equal(p, q) for p, q in zip(parameters, before[name])]
        assert sum(changed) >= len(changed) - 1, name  # all but the std, which no reset draws


def test_bad_input(make_loss, make_batch):
    with pytest.raises(ValueError, match=r"roa_coeff.*-0\.1"):
        make_loss(roa_coeff=-0.1)
    with pytest.raises(ValueError, match="positive"):
        make_loss(extrinsic_scale=torch.tensor([1.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match="RunningNormalizer"):
        make_loss(extrinsic_scale=nn.Linear(1, 1))
    loss = make_loss()
    loss.set_keys(latent="z")
    with pytest.raises(KeyError, match=r"encoder_network.*set_keys"):
        loss(make_batch())
    loss = make_loss()
    with pytest.raises(KeyError, match=r"extrinsic.*set_keys"):
        loss.adaptation_loss(make_batch().exclude(("privileged", "extrinsic")))

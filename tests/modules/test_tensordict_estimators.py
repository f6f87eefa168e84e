"""Estimators that are TensorDict modules: the check, and what those of the package compute."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torch import nn
from torchrl.modules import GRUModule

from tests.training.own_estimators import KINDS, Memory, Predicts, Unsure
from torchrl_atr.modules import (
    ActScale,
    EstimateHead,
    EstimatorModule,
    EstimatorSpec,
    RunningNormalizer,
    check_estimator,
    get_estimator,
)
from torchrl_atr.modules.checks import check_for
from torchrl_atr.modules.estimators import state_keys
from torchrl_atr.modules.estimators.self_supervised import balanced_assignment
from torchrl_atr.objectives import regression

SHAPE, OUT = (6, 5), 3
ROLES = ["intrinsic", "extrinsic", "both"]
NAMES = ["mlp", "cnn_gru", "tcn", "transformer", "gru", "gaussian", "ensemble", "variational", "contrastive"]


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("factory", [*map(get_estimator, NAMES), *KINDS.values()])
def test_all_kinds_pass_the_check(factory, role):
    check_estimator(factory, SHAPE, OUT, role)


@pytest.mark.parametrize("name", NAMES)
def test_further_inputs_count(name):
    spec = EstimatorSpec("both", SHAPE, {"intrinsic": 2, "extrinsic": 3}, {"wind": 2, ("more", "wind"): 1})
    check_for(get_estimator(name), spec)


class Privileged(Unsure):
    def __init__(self, spec):
        super().__init__(spec)
        self.in_keys = [*self.in_keys, spec.keys.extrinsic]


class OneEstimate(Unsure):
    def __init__(self, spec):
        super().__init__(spec)
        self.out_keys = self.out_keys[1:2] if spec.role == "both" else self.out_keys[:0]


class Unknown(Unsure):
    def __init__(self, spec):
        super().__init__(spec)
        self.in_keys = [*self.in_keys, "smell"]


class NegativeScale(Unsure):
    def forward(self, tensordict):
        super().forward(tensordict)
        for key in self.out_keys[len(self.out_keys) // 2 :]:
            tensordict[key] = -tensordict[key]
        return tensordict


class MeanLoss(Predicts):
    def losses(self, tensordict):
        return {name: loss.mean() for name, loss in super().losses(tensordict).items()}


class Constant(Predicts):
    def losses(self, tensordict):
        return {"constant": torch.zeros(tensordict.batch_size)}


class Undeclared(Predicts):
    def __init__(self, spec):
        super().__init__(spec)
        self.read, self.loss_in_keys = self.loss_in_keys, []

    def losses(self, tensordict):
        return {"prediction": tensordict[self.read[0]].square().mean(-1)}


class Forgetful(TensorDictSequential):
    """Its own recurrence, which over sequences does not begin anew."""

    def __init__(self, spec):
        features = spec.observation_features
        super().__init__(_NoResets(features, spec), EstimateHead(spec, 4))


class _NoResets(GRUModule):
    def __init__(self, features, spec):
        super().__init__(
            features, 4, in_keys=[spec.keys.observation, spec.state_key], out_keys=["features", spec.next_state_key]
        )

    def forward(self, tensordict):
        never = tensordict.copy().set("is_init", torch.zeros_like(tensordict["is_init"]))
        return tensordict.update(super().forward(never).select(*self.out_keys))


class NoPrimer(Memory):
    def __init__(self, spec):
        super().__init__(spec)
        del spec

    def make_tensordict_primer(self):
        raise NotImplementedError


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        (lambda spec: nn.Linear(1, 1), "'module'.*TensorDictModuleBase, as it takes a spec"),
        (Privileged, "'in_keys'.*not known where the policy is deployed"),
        (OneEstimate, "'out_keys'.*declare and write all"),
        (Unknown, "'in_keys'.*smell.*estimator_inputs"),
        (NegativeScale, "'scale'.*not positive"),
        (MeanLoss, r"'losses'.*one number for each sample, \(3, 4\)"),
        (Constant, "'gradients'.*predict"),
        (Undeclared, "KeyError"),
        (Forgetful, "'memory'.*begin anew where 'is_init'"),
        (NoPrimer, "NotImplementedError"),
    ],
)
@pytest.mark.parametrize("role", ["extrinsic", "both"])
def test_the_check_names_what_is_wrong(factory, message, role):
    with pytest.raises(AssertionError, match=message):
        check_estimator(factory, SHAPE, OUT, role)


def test_estimates_and_scales_are_in_the_units_of_the_target():
    spec = EstimatorSpec("both", SHAPE, {"intrinsic": 2, "extrinsic": 3})
    unit = RunningNormalizer(3)
    unit.update(torch.randn(500, 3) * torch.tensor([1.0, 10.0, 0.1]) + 5)
    net = Unsure(spec)
    data = TensorDict(history=torch.randn(7, *SHAPE), batch_size=[7])
    raw, out = net(data.clone()), EstimatorModule(net, spec, RunningNormalizer(5), unit)(data.clone())
    wanted = raw.clone()
    wanted["estimate", "extrinsic"] = raw["estimate", "extrinsic"] * unit.std + unit.mean
    wanted["estimate", "extrinsic_scale"] = raw["estimate", "extrinsic_scale"] * unit.std
    for key in [*spec.estimate_keys, *spec.scale_keys]:  # an untrained normaliser divides by sqrt(1 + eps)
        torch.testing.assert_close(out[key], wanted[key], atol=1e-3, rtol=1e-3)


def test_an_ensemble_is_surer_where_it_was_trained():
    torch.manual_seed(0)
    spec = EstimatorSpec("extrinsic", (2, 1), {"extrinsic": 1})
    ensemble = get_estimator("ensemble")(spec, members=4, cells=[32, 32])
    optimizer = torch.optim.Adam(ensemble.parameters(), 1e-2)
    for _ in range(400):
        history = torch.rand(128, 2, 1) * 2 - 1
        target = torch.sin(3 * history[:, 1]) + 0.1 * torch.randn(128, 1)
        out = ensemble(TensorDict(history=history, batch_size=[128]))
        mean, scale = out["estimate", "extrinsic"], out["estimate", "extrinsic_scale"]
        loss, _, calibration = regression(mean, target, scale=scale)
        optimizer.zero_grad()
        loss.mean().backward()
        optimizer.step()
    scale = scale.detach()
    assert 0.7 < float(calibration) < 1.4
    assert float(scale.mean()) == pytest.approx(0.1, rel=0.5)  # the noise, which no member can know
    elsewhere = ensemble(TensorDict(history=torch.full((1, 2, 1), 5.0), batch_size=[1]))
    assert float(elsewhere["estimate", "extrinsic_scale"]) > 5 * float(scale.mean())


def test_an_ensemble_has_members():
    with pytest.raises(ValueError, match="members=1: choose a whole number, 2 or more"):
        get_estimator("ensemble")(EstimatorSpec("extrinsic", SHAPE, {"extrinsic": OUT}), members=1)


def test_a_recurrent_estimator_reads_no_history_and_what_it_writes_is_declared():
    spec = EstimatorSpec("extrinsic", SHAPE, {"extrinsic": OUT})
    module = EstimatorModule(get_estimator("gru")(spec), spec, RunningNormalizer(5), RunningNormalizer(OUT))
    assert module.in_keys == ["observation", "extrinsic_estimator_state", "is_init"]
    assert module.out_keys == [("estimate", "extrinsic"), ("next", "extrinsic_estimator_state")]
    assert state_keys(module) == ["extrinsic_estimator_state"]


@pytest.mark.parametrize("length", [1, 2, 3, 7, 16])
def test_a_tcn_sees_the_whole_window(length):
    net, history = get_estimator("tcn")((length, 5), OUT, channels=8), torch.randn(2, length, 5, requires_grad=True)
    net(history).sum().backward()
    assert bool((history.grad.abs().sum((0, 2)) > 0).all())


@pytest.mark.parametrize("name", ["tcn", "transformer"])
def test_order_matters(name):
    history = torch.randn(1, *SHAPE)
    net = get_estimator(name)(SHAPE, OUT)
    assert not torch.allclose(net(history), net(history.flip(1)))


def test_assignments_use_all_prototypes_alike():
    shares = balanced_assignment(torch.randn(5, 40, 8), iterations=200, temperature=0.3)
    assert shares.shape == (5, 40, 8)
    torch.testing.assert_close(shares.sum(-1), torch.ones(5, 40))
    torch.testing.assert_close(shares.sum((0, 1)), torch.full((8,), 25.0), rtol=1e-2, atol=0.0)


def test_the_divergence_from_the_prior_by_hand():
    """KL(N(m, s) || N(0, 1)) = (s² + m² - 1) / 2 - ln s, summed over the code: here 0.5 + 2, and (1.5 - ln 2) + 0."""
    net = get_estimator("variational")(
        EstimatorSpec("extrinsic", (1, 5), {"extrinsic": OUT}), "mlp", code=2, coeff=3.0, kl_coeff=0.1
    )
    code = {"code_mean": torch.tensor([[1.0, 2.0], [0.0, 0.0]]), "code_std": torch.tensor([[1.0, 1.0], [2.0, 1.0]])}
    losses = net.losses(TensorDict({**code, "next": {"observation": torch.zeros(2, 5)}}, [2]))
    torch.testing.assert_close(losses["kl"], 0.3 * torch.tensor([2.5, 1.5 - math.log(2.0)]))


def test_a_contrast_by_hand():
    """Each side predicts the assignment of the other; both are balanced as they are, by the symmetry of the scores.

    Windows are their prototypes, by cosines of 1 and 0; what follows leans the other way, by cosines of 0.6 and 0.8.
    """
    net = get_estimator("contrastive")(
        EstimatorSpec("extrinsic", (1, 2), {"extrinsic": OUT}), "mlp", features=2, embedding=2, prototypes=2, coeff=3.0
    )
    net.of_window, net.of_next, net.prototypes = nn.Identity(), nn.Identity(), nn.Parameter(torch.eye(2))
    following = {"observation": torch.tensor([[0.6, 0.8], [0.8, 0.6]])}
    losses = net.losses(TensorDict({"features": torch.eye(2), "next": following}, [2]))

    def entropy(share: float, lead: float) -> float:
        """Of predicting a share of one prototype by scores that lead by so much there."""
        return math.log1p(math.exp(-lead)) + (1.0 - share) * lead

    # assignments by scores / 0.05: e^20 to 1 for its own, and e^4 to 1 for the other; predictions by scores / 0.2
    of_next, of_window = 1.0 / (1.0 + math.exp(4.0)), 1.0 / (1.0 + math.exp(-20.0))
    expected = 3.0 * 0.5 * (entropy(of_next, 5.0) + entropy(of_window, -1.0))
    assert losses["contrast"].tolist() == pytest.approx([expected, expected], rel=1e-5)


def test_a_contrast_is_low_where_windows_tell_what_follows():
    """Trained on it alone: the loss of matching pairs sinks below that of shuffled ones."""
    torch.manual_seed(0)
    spec = EstimatorSpec("extrinsic", (1, 5), {"extrinsic": OUT})
    net = get_estimator("contrastive")(spec, trunk="mlp", features=16, prototypes=8)
    optimizer = torch.optim.Adam(net.parameters(), 1e-2)

    def contrast(observation, following):
        data = TensorDict(history=observation.unsqueeze(1), batch_size=[len(observation)])
        return net.losses(net(data).set(("next", "observation"), following))["contrast"].mean()

    for _ in range(60):
        observation = torch.randn(128, 5)
        optimizer.zero_grad()
        contrast(observation, observation).backward()
        optimizer.step()
    observation = torch.randn(256, 5)
    with torch.no_grad():
        assert contrast(observation, observation) < 0.8 * contrast(observation, observation.roll(1, 0))


def test_an_act_scale_is_zero_for_the_truth():
    data = TensorDict(
        s=torch.rand(4, 3) + 0.1,
        x=torch.randn(4, 3),
        student=torch.tensor([[True], [True], [False], [False]]),
        batch_size=[4],
    )
    make = {"scale": "s", "chosen": "x", "student": "student", "act_scale": "out"}
    read = {source: ActScale(source, **make)(data.copy())["out"] for source in ("privileged", "estimated", "mixed")}
    assert not read["privileged"].any()
    assert torch.equal(read["estimated"], data["s"])
    assert torch.equal(read["mixed"], torch.where(data["student"], data["s"], 0.0))
    with pytest.raises(KeyError, match="no estimator wrote"):
        ActScale("estimated", **make)(data.exclude("s"))


def test_targets_that_are_not_the_roles_are_refused():
    with pytest.raises(ValueError, match="the role 'both' estimates intrinsic and extrinsic"):
        EstimatorSpec("both", SHAPE, {"extrinsic": 3})
    with pytest.raises(ValueError, match="role"):
        EstimatorSpec("nobody", SHAPE, {"extrinsic": 3})

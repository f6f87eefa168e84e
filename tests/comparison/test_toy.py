"""A linear-Gaussian toy, in which R², calibration and probe of the best estimator are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Composite, Unbounded

from torchrl_atr._threads import one_torch_thread
from torchrl_atr.comparison import CompareOptions, ComparisonError, Recording, score
from torchrl_atr.comparison.fitting import entries_read, estimates, fit
from torchrl_atr.comparison.recording import AGE
from torchrl_atr.comparison.scores import BINS, score_latent
from torchrl_atr.comparison.summary import estimator_figures
from torchrl_atr.evaluation.access import Component
from torchrl_atr.modules import EstimateHead, make_networks
from torchrl_atr.modules.estimators import _ESTIMATORS
from torchrl_atr.training import make_config

NOISE = 0.5
"""Standard deviation of what the history lacks; all else has 1."""
ROBOTS, STEPS = 60, 120
SPEC = Composite(
    observation=Unbounded((4,)),
    history=Unbounded((1, 4)),
    privileged=Composite(intrinsic=Unbounded((3,)), extrinsic=Unbounded((2,))),
)


class Linear(nn.Linear):
    def __init__(self, history_shape, out_features):
        super().__init__(history_shape[0] * history_shape[1], out_features)

    def forward(self, history):
        return super().forward(history.flatten(-2))


@pytest.fixture(autouse=True)
def one_thread():
    with one_torch_thread():  # others only wait where CPUs are busy
        yield


def linear_gaussian(spec):
    return TensorDictSequential(
        TensorDictModule(nn.Flatten(-2), [spec.keys.history], ["features"]), EstimateHead(spec, 4, scale=True)
    )


class Encoder(nn.Module):
    """The first two of three hidden parameters are the latent."""

    def forward(self, intrinsic):
        return intrinsic[..., :2]


@pytest.fixture(autouse=True)
def own_estimators(monkeypatch):
    mine = {"linear": Linear, "linear_gaussian": linear_gaussian}
    monkeypatch.setattr(_ESTIMATORS, "_entries", {**_ESTIMATORS._entries, **mine})


def toy(encoder=None):
    """o = (p_0 + noise, p_1 + noise, a, b); x_ext = (a + noise, 3 b); z = (p_0, p_1); all are independent."""
    draw = torch.Generator().manual_seed(0)

    def normal(*size):
        return torch.randn(ROBOTS, STEPS, *size, generator=draw)

    hidden, seen = normal(3), normal(2)
    history = torch.cat([hidden[..., :2] + NOISE * normal(2), seen], -1)
    extrinsic = torch.stack([seen[..., 0] + NOISE * normal(), 3 * seen[..., 1]], -1)
    age = torch.arange(STEPS).expand(ROBOTS, STEPS).unsqueeze(-1)
    data = TensorDict(
        {
            "history": history.unsqueeze(-2),
            "observation": history,
            "privileged": {"intrinsic": hidden, "extrinsic": extrinsic},
            "latent": {"intrinsic": hidden[..., :2]},
            "is_init": age == 0,
            AGE: age,
        },
        batch_size=[ROBOTS, STEPS],
    )
    components = Component("a", "a", "m/s"), Component("b", "b", "m")
    return Recording(data, 40, components, ("seen[0]", "seen[1]", "unseen"))


def trained(name, recording, updates=250):
    torch.manual_seed(0)
    networks = make_networks(
        SPEC, Unbounded((2,)), estimator=name, latent_features=2, actor_cells=[4], critic_cells=[4]
    )
    networks.encoder = Encoder()
    networks.ext_norm.update(recording.data["privileged", "extrinsic"])
    config = make_config({"estimator.name": name, "estimator.learning_rate": 0.02})
    fit(networks, config, recording, CompareOptions(updates=updates, batch=256), seed=0)
    return networks, estimator_figures([score(networks, recording)], recording)


def test_the_best_linear_estimator_reaches_what_theory_says():
    _, figures = trained("linear", toy())
    first, second = figures["components"]
    assert first["rmse"]["value"] == pytest.approx(NOISE, rel=0.05)
    assert first["r_squared"]["value"] == pytest.approx(1 / (1 + NOISE**2), abs=0.03)
    assert first["rmse"]["low"] < NOISE < first["rmse"]["high"]
    assert second["r_squared"]["value"] == pytest.approx(1.0, abs=0.01)
    assert figures["error"]["value"] == pytest.approx(np.sqrt(NOISE**2 / (1 + NOISE**2) / 2), rel=0.06)
    # E[p | p + noise] = (p + noise) / (1 + NOISE²)
    assert figures["latent"]["r_squared"]["value"] == pytest.approx(1 / (1 + NOISE**2), abs=0.03)
    assert figures["latent"]["rmse"]["value"] == pytest.approx(np.sqrt(2 * NOISE**2 / (1 + NOISE**2)), rel=0.05)
    assert figures["latent"]["effective_dimension"] == pytest.approx(2.0, abs=0.1)
    probe = [row["value"] for row in figures["probe"]["parameters"].values()]
    assert probe == pytest.approx([1 / (1 + NOISE**2)] * 2 + [0.0], abs=0.06)
    assert figures["parameters"] == 2 * (4 * 2 + 2)
    assert figures["calibration"] is None
    assert figures["microseconds"] > 0


def test_without_a_trend_there_is_no_drift_and_every_step_counts_once():
    _, figures = trained("linear", toy(), updates=200)
    drift = figures["drift"]
    assert len(drift["seconds"]) == BINS
    assert drift["value"] == pytest.approx(figures["error"]["value"], rel=0.3)
    assert np.sqrt((drift["value"] ** 2).mean()) == pytest.approx(figures["error"]["value"])


def test_drift_is_seen_where_the_error_grows_with_the_ride():
    recording = toy()
    networks, _ = trained("linear", recording)
    grown = recording.data.clone()
    grown["privileged", "extrinsic"] += 0.05 * grown[AGE]
    later = Recording(grown, recording.training, recording.components, recording.intrinsics)
    drift = estimator_figures([score(networks, later)], later)["drift"]
    assert (np.diff(drift["value"])[5:] > 0).all()


def test_a_scale_that_is_learned_by_likelihood_is_calibrated():
    _, figures = trained("linear_gaussian", toy())
    assert figures["components"][0]["calibration"]["value"] == pytest.approx(1.0, abs=0.1)
    assert figures["latent"]["calibration"]["value"] == pytest.approx(1.0, abs=0.1)


def test_the_probe_of_the_true_latent_is_perfect_on_what_it_holds():
    recording = toy()
    networks, _ = trained("linear", recording, updates=1)
    sums, dimension = score_latent(networks, recording)
    assert sums["probe"].sum(0)[:2] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert sums["probe"].sum(0)[2] == pytest.approx(sums["probe_truth_squared"].sum(0)[2], rel=0.1)
    assert dimension == pytest.approx(2.0, abs=0.1)


def test_training_changes_the_estimators_alone():
    recording = toy()
    one, _ = trained("linear", recording, updates=1)
    other, _ = trained("linear", recording, updates=3)
    changed = {name for name, value in one.state_dict().items() if not torch.equal(value, other.state_dict()[name])}
    assert changed
    assert all(name.startswith(("intrinsic_estimator.net", "extrinsic_estimator.net")) for name in changed)


@pytest.mark.parametrize("name", ["gru", "linear"])
def test_estimates_over_a_recording_forget_where_a_ride_begins(name):
    networks, _ = trained(name, toy(), updates=1)
    data = toy().data[:2].clone()
    data["is_init"][0, 50] = True
    ((_, written),) = estimates(networks, data)
    ((_, alone),) = estimates(networks, data[:, 50:])
    torch.testing.assert_close(written["estimate", "extrinsic"][0, 50:], alone["estimate", "extrinsic"][0])
    carried = torch.allclose(written["estimate", "extrinsic"][1, 50:], alone["estimate", "extrinsic"][1])
    assert carried == (name == "linear")


def test_what_was_not_recorded_is_named():
    networks = make_networks(SPEC, Unbounded((2,)), estimator="variational", estimator_kwargs={"trunk": "mlp"})
    with pytest.raises(ComparisonError, match=r"'variational' reads \('next', 'observation'\), which was not recorded"):
        toy().check_holds(entries_read(networks), "variational")

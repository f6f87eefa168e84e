"""Wrong estimators: training says what is wrong with them before anything is written."""

from __future__ import annotations

import time

import pytest
import torch
from torch import nn

from torchrl_atr.cli import main
from torchrl_atr.modules.checks import check_registered
from torchrl_atr.modules.estimators import _ESTIMATORS, EstimatorSpec
from torchrl_atr.training import CheckpointError, Trainer, load_run, make_config

SETTINGS = {
    "env.num_envs": 2,
    "ppo.rollout_steps": 2,
    "total_frames": 8,
    "compute.num_threads": 1,
    "ppo.minibatches": 1,
    "ppo.critic_cells": [8],
}


class Plain(nn.Module):
    """The newest observation through one layer."""

    def __init__(self, history_shape, out_features):
        super().__init__()
        self.head = nn.Linear(history_shape[-1], out_features)

    def forward(self, history):
        return self.head(history[..., -1, :])


class TwoOutputs(Plain):
    def forward(self, history):
        return super().forward(history), history


class KeepsState(Plain):
    last = None

    def forward(self, history):
        out = super().forward(history)
        if self.last is not None and self.last.shape == out.shape:
            out = out + self.last
        self.last = out.detach()
        return out


class KeepsStateOfOneSize(Plain):
    last = 0.0

    def forward(self, history):
        self.last = super().forward(history) + self.last
        return self.last


class KeepsStateInTraining(Plain):
    last = None

    def forward(self, history):
        out = super().forward(history)
        if self.training:
            out = out + (0.0 if self.last is None else self.last)
            self.last = out
        return out


class Detached(Plain):
    def forward(self, history):
        return super().forward(history).detach()


class DetachedWeights(Plain):
    def forward(self, history):
        return nn.functional.linear(history[..., -1, :], self.head.weight.detach(), self.head.bias.detach())


class NoCopy(Plain):
    def __deepcopy__(self, memo):
        raise TypeError("one of a kind")


class WrongShape(Plain):
    def forward(self, history):
        return super().forward(history).unsqueeze(-2)


class NotFinite(Plain):
    def forward(self, history):
        return super().forward(history).log()


class InPlace(Plain):
    def forward(self, history):
        history[..., 0] = 0.0
        return super().forward(history)


class Raises(Plain):
    def forward(self, history):
        raise KeyError("the moon")


class RaisesInTraining(Plain):
    def forward(self, history):
        if self.training:
            raise LookupError("only at night\nand more\n" * 50)
        return super().forward(history)


class RaisesWhenMade(Plain):
    def __init__(self, history_shape, out_features):
        raise ZeroDivisionError("no such size")


class OneSizeOnly(Plain):
    """As one that was written for the sizes in the README: the extrinsic estimator has others."""

    def __init__(self, history_shape, out_features):
        super().__init__((10, 46), 16)


class Lazy(Plain):
    def __init__(self, history_shape, out_features):
        super().__init__(history_shape, out_features)
        self.head = nn.LazyLinear(out_features)


@pytest.fixture
def registered(monkeypatch):
    """``registered(factory)``: known as ``mine`` in this test."""
    monkeypatch.setattr(_ESTIMATORS, "_entries", dict(_ESTIMATORS._entries))

    def register(factory):
        _ESTIMATORS._entries["mine"] = factory

    return register


@pytest.mark.parametrize(
    ("factory", "property_", "remedy"),
    [
        (TwoOutputs, "'output'", "return one Tensor"),
        (KeepsState, "'deterministic'", "keep no state between calls"),
        (KeepsStateOfOneSize, "'deterministic'", "Keep no state between calls"),
        (KeepsStateInTraining, "'training'", "no state between calls"),
        (Detached, "'gradients'", "carries no gradient"),
        (DetachedWeights, "'gradients'", "carries no gradient"),
        (NoCopy, "'copy'", "one of a kind"),
        (WrongShape, "'shape'", "return (16,)"),
        (NotFinite, "'finite'", "non-finite output"),
        (InPlace, "'input unchanged'", "work on a copy"),
        (Raises, "KeyError", "the moon"),
        (RaisesInTraining, "LookupError", "only at night"),
        (RaisesWhenMade, "ZeroDivisionError", "no such size"),
        (OneSizeOnly, "'leading dimensions'", "history of shape (10, 49)"),
        (Lazy, "'module'", "give all sizes"),
        (lambda history_shape, out_features: None, "'module'", "return an nn.Module"),
        (lambda **sizes: Plain(**sizes, width=3), "TypeError", "unexpected keyword argument 'width'"),
    ],
)
def test_refused_before_anything_is_written(refused, registered, tmp_path, tiny, factory, property_, remedy):
    registered(factory)
    train = ["train", *tiny, "--estimator", "mine", "--output", tmp_path / "run"]
    refused(train, "estimator 'mine' cannot be trained. Estimator check", remedy)
    refused(train, property_, remedy)
    assert not (tmp_path / "run").exists()


def of(features):
    return EstimatorSpec("extrinsic", (10, features), {"extrinsic": 16})


def test_the_check_is_quick():
    check_registered("mlp", [of(46)])
    begun = time.process_time()  # not what other processes take
    check_registered("cnn_gru", [of(46), of(49)])
    assert time.process_time() - begun < 1.0


def test_the_check_draws_no_random_number(registered, tmp_path):
    registered(Plain)
    state = torch.get_rng_state()
    check_registered("mine", [of(46)])
    assert torch.equal(torch.get_rng_state(), state)


class Wider(Plain):
    def __init__(self, history_shape, out_features):
        super().__init__(history_shape, out_features)
        self.more = nn.Linear(out_features, out_features)


class RemembersMore(Plain):
    """Has a state of another kind than the class that was trained."""

    def get_extra_state(self):
        return {"seen": 3}

    def set_extra_state(self, state):
        raise KeyError("seen")


@pytest.mark.parametrize("factory", [Wider, RemembersMore, RaisesWhenMade])
def test_a_run_whose_estimator_changed_is_named(registered, refused, tmp_path, factory):
    registered(Plain)
    run = tmp_path / "run"
    Trainer(make_config({**SETTINGS, "estimator.name": "mine"}), run).save()
    registered(factory)
    with pytest.raises(CheckpointError, match=r"estimator") as caught:
        load_run(run, num_envs=1)
    assert len(str(caught.value).splitlines()) == 1
    refused(["evaluate", run], str(run), "estimator")


def test_what_each_estimator_is_is_listed(registered, capsys, tmp_path):
    from functools import partial

    registered(partial(Plain))
    _ESTIMATORS._entries["unnamed"] = lambda history_shape, out_features: Plain(history_shape, out_features)
    _ESTIMATORS._entries["bare"] = TwoOutputs
    _ESTIMATORS._entries["broken"] = RaisesWhenMade
    assert main(["list", "estimators"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert "torchrl_atr.modules.estimators.window.CNNGRUEstimator" in rows["cnn_gru"]
    name = "tests.wrong_inputs.test_estimators.Plain"
    assert rows["mine"].split(maxsplit=3)[1:] == [name, "752", "The newest observation through one layer."]
    assert "<lambda>" in rows["unnamed"]
    assert "The newest observation through one layer." in rows["unnamed"]
    assert "Base class" not in rows["bare"]
    assert "no such size" in rows["broken"]

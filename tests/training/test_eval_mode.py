"""What a policy returns is what a user deploys: networks that are handed out to be used are in eval mode."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from torchrl_atr.envs import make_riding_env
from torchrl_atr.evaluation import evaluate_tracking
from torchrl_atr.evaluation.video import ride_with_resets
from torchrl_atr.modules import MLPEstimator
from torchrl_atr.modules.estimators import _ESTIMATORS
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, Trainer, load_run, make_config

TINY = {
    "env.num_envs": 8,
    "ppo.rollout_steps": 4,
    "total_frames": 64,
    "compute.num_threads": 1,
    "ppo.minibatches": 1,
    "ppo.critic_cells": [8],
}


class Dropout(MLPEstimator):
    """Forgets half of its input in training."""

    def forward(self, history):
        return super().forward(nn.functional.dropout(history, 0.5, self.training))


class BatchNorm(MLPEstimator):
    """Normalises by the batch in training."""

    def __init__(self, history_shape, out_features):
        super().__init__(history_shape, out_features)
        self.norm = nn.BatchNorm1d(history_shape[0] * history_shape[1])

    def forward(self, history):
        flat = self.norm(history.reshape(-1, history.shape[-2] * history.shape[-1]))
        return super().forward(flat.reshape(history.shape))


@pytest.fixture(scope="module", params=[Dropout, BatchNorm])
def trainer(request, tmp_path_factory):
    """A finished run whose estimators do something else in training."""
    name = request.param.__name__
    _ESTIMATORS._entries[name] = request.param
    trainer = Trainer(make_config({**TINY, "estimator.name": name}), tmp_path_factory.mktemp(name) / "run")
    trainer.train()
    yield trainer
    del _ESTIMATORS._entries[name]


def modes(networks):
    return {module.training for module in networks.modules()}


@pytest.fixture
def seen():
    env = make_riding_env(num_envs=4, num_threads=1, seed=0, observe_tilt=True)
    return env.rollout(3, break_when_any_done=False)[:, -1]


def test_a_loaded_policy_says_the_same_twice_and_on_each_robot_alone(trainer, seen):
    _, _, networks, _ = load_run(trainer.run, num_envs=1)
    assert modes(networks) == {False}
    policy = networks.deployed_policy()
    assert modes(policy) == {False}
    together = policy(seen.clone())["loc"]
    assert torch.equal(policy(seen.clone())["loc"], together)
    torch.testing.assert_close(policy(seen[:1].clone())["loc"], together[:1], rtol=1e-4, atol=1e-5)


def test_what_the_learner_deploys_is_what_is_loaded(trainer, seen):
    assert modes(trainer.learner.deployed) == {False}
    policies = [trainer.learner.deployed.deployed_policy(), load_run(trainer.run, num_envs=1)[2].deployed_policy()]
    first, second = (policy(seen.clone())["loc"] for policy in policies)
    assert torch.equal(first, second)


def test_training_itself_stays_in_training_mode(trainer):
    assert modes(trainer.learner.networks) == {True}


def test_using_a_policy_leaves_every_module_in_the_mode_that_it_was_in(trainer):
    _, env, loaded, _ = load_run(trainer.run, num_envs=2, **DEPLOYMENT_OVERRIDES)
    trained = trainer.learner.networks
    for networks, expected in ((loaded, {False}), (trained, {True})):
        list(ride_with_resets(networks.deployed_policy(), env, [(0.0, 0.0, 0.0)], 2))
        assert modes(networks) == expected
        evaluate_tracking(
            networks.deployed_policy(),
            lambda num_envs, seed: make_riding_env(num_envs=num_envs, seed=seed, num_threads=1, observe_tilt=True),
            ([0.0], [0.0]),
            robots_per_command=2,
            seconds=0.2,
            settle=0.1,
        )
        assert modes(networks) == expected


def test_a_ride_is_that_of_the_deployed_policy(trainer):
    """Played from networks in training mode, too: twice the same, bit for bit."""
    rides = []
    for networks in (trainer.learner.networks, trainer.learner.networks):
        env = make_riding_env(num_envs=1, num_threads=1, seed=3, observe_tilt=True)
        list(ride_with_resets(networks.deployed_policy(), env, [(0.0, 0.5, 0.0)], 10))
        rides.append(env.base_env.engine.qpos.clone())
    assert (rides[0] == rides[1]).all()

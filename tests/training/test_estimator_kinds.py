"""Estimators of every kind train, continue bit for bit and are deployed: those of the package and a user's own."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from tests.training.cart import CartEnv, make_cart
from tests.training.own_estimators import KINDS
from tests.training.states import SMALL as RIDING
from tests.training.states import differing
from torchrl_atr.evaluation import evaluate_tracking
from torchrl_atr.modules import make_networks, with_state
from torchrl_atr.modules.estimators import _ESTIMATORS, state_keys
from torchrl_atr.training import (
    Learner,
    Trainer,
    load_checkpoint,
    load_run,
    make_config,
    make_env,
    make_run_loss,
)
from torchrl_atr.training.assembly import DEPLOYMENT_OVERRIDES

SMALL = {
    "env.num_envs": 6,
    "ppo.rollout_steps": 5,
    "total_frames": 4 * 30,
    "compute.num_threads": 1,
    "compute.torch_threads": 1,
    "ppo.minibatches": 2,
    "ppo.epochs": 1,
}
BOX = {
    "cnn_gru": {"gru_features": 4, "channels": 4, "mlp_cells": [4]},
    "mlp": {"cells": [4]},
    "tcn": {"channels": 4},
    "transformer": {"features": 4, "heads": 2, "layers": 1},
    "gru": {"features": 4, "cells": [4]},
    "gaussian": {"trunk": "mlp", "features": 4},
    "ensemble": {"members": 2, "cells": [4]},
    "variational": {"trunk": "mlp", "features": 4, "code": 2},
    "contrastive": {"trunk": "mlp", "features": 4, "embedding": 3, "prototypes": 4},
}
ALL = [*BOX, *KINDS]
WITH_SCALE = ["gaussian", "ensemble", "unsure"]
SOURCES = ["privileged", "estimated", "mixed"]


@pytest.fixture(autouse=True)
def own_estimators(monkeypatch):
    monkeypatch.setattr(_ESTIMATORS, "_entries", {**_ESTIMATORS._entries, **KINDS})


def small_networks(env, name, shared=False, scale=False):
    return make_networks(
        env.observation_spec,
        env.action_spec,
        estimator=name,
        estimator_kwargs=BOX.get(name, {}),
        latent_features=2,
        actor_cells=(8,),
        critic_cells=(8,),
        shared_estimator=shared,
        actor_reads_scale=scale,
    )


def collected(networks, env, source, steps=9) -> TensorDictBase:
    """A batch of (N, T) steps; carts run for seven."""
    policy = networks.rollout_policy(source)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        return with_state(env, policy).rollout(steps, policy, break_when_any_done=False)


def touched(networks):
    names = ["encoder", "backbone", "exploration", "critic", "intrinsic_estimator", "extrinsic_estimator"]
    parameters = {name: getattr(networks, name).parameters() for name in names}
    return {name for name, each in parameters.items() if any(p.grad is not None and p.grad.any() for p in each)}


@pytest.fixture
def learner_of():
    def make(name, source="mixed", shared=False, scale=False):
        torch.manual_seed(0)
        env = make_cart(6)
        networks = small_networks(env, name, shared, scale)
        return Learner(networks, make_config({**SMALL, "roa.act_source": source})), env

    return make


@pytest.mark.parametrize(
    ("name", "shared", "source"),
    [
        *(
            (name, name in ("gru", "gaussian", "mlp"), source)
            for name in ALL
            for source in SOURCES
            if source != "mixed"
        ),
        *((name, shared, "mixed") for name in ALL for shared in (False, True)),
    ],
)
def test_the_first_minibatch_has_ratio_one_after_the_estimators_moved(learner_of, name, shared, source):
    learner, env = learner_of(name, source, shared, scale=name in WITH_SCALE)
    batch = collected(learner.networks, env, source)
    with torch.no_grad():
        learner.advantage(batch)
        for parameter in learner.networks.estimator_parameters():
            parameter.mul_(1.5).add_(0.1)
        batch["previous_mean"] = batch["loc"]
        minibatch = batch.reshape(-1).select(*learner.loss.policy_in_keys, strict=False)[::2]
        if source == "privileged" and ("estimate", "intrinsic") not in minibatch.keys(True):
            minibatch["estimate", "intrinsic"] = torch.zeros(len(minibatch), 2)
        out = learner.loss.policy_loss(minibatch)
    assert abs(float(out["max_ratio"]) - 1) < 1e-4
    assert float(out["clip_fraction"]) == 0


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("name", ALL)
def test_gradients_go_exactly_where_they_belong(learner_of, name, shared):
    learner, env = learner_of(name, "mixed", shared, scale=name in WITH_SCALE)
    networks, loss = learner.networks, learner.loss
    batch = collected(networks, env, "mixed")
    with torch.no_grad():
        learner.advantage(batch)
    batch["previous_mean"] = batch["loc"] + 1.0
    estimators = {"intrinsic_estimator", "extrinsic_estimator"}
    policy = {"encoder", "backbone", "exploration", "critic"}

    def routes(terms):
        found = {}
        for key, term in terms.items():
            if key.startswith("loss_"):
                networks.zero_grad()
                term.backward(retain_graph=True)
                found[key] = touched(networks)
        return found

    of_policy = routes(loss.policy_loss(batch.reshape(-1)))
    assert set().union(*of_policy.values()) == policy
    assert of_policy["loss_roa"] == {"encoder"}
    of_estimators = routes(loss.adaptation_loss(batch))
    for key, reached in of_estimators.items():
        role = key.split("_")[1]
        assert reached == (estimators if shared else {f"{role}_estimator"}), key


@pytest.mark.parametrize("functional", [True, False])
@pytest.mark.parametrize("name", ["gru", "variational", "gaussian", "memory"])
@pytest.mark.parametrize("shared", [False, True])
def test_a_functional_loss_is_the_same_and_lists_each_parameter_once(learner_of, name, shared, functional):
    learner, env = learner_of(name, "mixed", shared)
    networks = learner.networks
    loss = make_run_loss(learner.config, networks, functional=functional)
    batch = collected(networks, env, "mixed")
    torch.manual_seed(0)
    expected = learner.loss.adaptation_loss(batch)
    torch.manual_seed(0)
    for key, value in loss.adaptation_loss(batch).items():
        torch.testing.assert_close(value, expected[key], msg=key)
    ids = [id(parameter) for parameter in loss.parameters()]
    assert len(ids) == len(set(ids)) == len(list(networks.parameters()))


@pytest.mark.parametrize("name", ["gru", "memory"])
def test_sequences_give_the_estimates_of_the_rollout_across_resets_and_batches(learner_of, name):
    learner, env = learner_of(name)
    policy = learner.networks.rollout_policy("mixed")
    env = with_state(env, policy)
    with torch.no_grad():
        first = env.rollout(4, policy, break_when_any_done=False)
        start = step_mdp(first[:, -1])
        second = env.rollout(8, policy, break_when_any_done=False, auto_reset=False, tensordict=start)
    assert second["is_init"].any()  # carts run for seven steps
    assert not second["is_init"][:, 0].any()
    (key,) = state_keys(learner.networks.extrinsic_estimator_module)
    assert second[key][:, 0].any()
    with torch.no_grad():
        written, _ = learner.loss._estimate(second)
    for estimate in ("intrinsic", "extrinsic"):
        torch.testing.assert_close(written["estimate", estimate], second["estimate", estimate])


def test_shuffled_steps_are_refused_where_there_is_a_hidden_state(learner_of):
    learner, env = learner_of("gru")
    batch = collected(learner.networks, env, "mixed")
    with pytest.raises(ValueError, match=r"hidden state.*sequences of steps in their order, \(n, T\)"):
        learner.loss.adaptation_loss(batch.reshape(-1))
    with pytest.raises(KeyError, match=r"with_state\(env, policy\)"):
        learner.networks.deployed_policy()(make_cart(6).reset())


@pytest.mark.parametrize(("name", "shapes"), [("mlp", [(15,), (15,)]), ("gru", [(3, 5), (3, 5)])])
def test_only_a_memory_is_trained_on_sequences(learner_of, name, shapes):
    learner, env = learner_of(name)
    policy, adaptation, seen = learner.loss.policy_loss, learner.loss.adaptation_loss, {"policy": [], "estimators": []}
    learner.loss.policy_loss = lambda data: (seen["policy"].append(data.shape), policy(data))[1]
    learner.loss.adaptation_loss = lambda data: (seen["estimators"].append(data.shape), adaptation(data))[1]
    learner.update(collected(learner.networks, env, "mixed", steps=5))
    assert seen == {"policy": [(15,), (15,)], "estimators": shapes}


def networks_for(name, env, **options):
    return small_networks(env, name, **options)


@pytest.mark.parametrize(
    ("name", "source"),
    [*((name, "mixed") for name in [*KINDS, "variational", "contrastive"]), ("gru", "privileged")],
)
def test_it_goes_on_bit_for_bit(tmp_path, name, source):
    config = make_config({**SMALL, "roa.act_source": source})
    make = {"make_env": make_cart, "make_networks": partial(networks_for, name, scale=name in WITH_SCALE)}
    metrics = []
    Trainer(config, tmp_path / "straight", **make).train(metrics.append)
    Trainer(config, tmp_path / "halves", **make).train(lambda metrics: metrics["iteration"] == 2)
    Trainer(config, tmp_path / "halves", load_checkpoint(tmp_path / "halves"), **make).train()
    ends = [load_checkpoint(tmp_path / folder) for folder in ("straight", "halves")]
    for end in ends:
        for clock in ("seconds", "provenance", "best_reward"):
            del end[clock]
    assert differing(*ends) == []
    own = {"predicts": "prediction", "variational": "reconstruction", "contrastive": "contrast"}
    assert name not in own or f"loss_extrinsic_{own[name]}" in metrics[-1]
    assert ("extrinsic_calibration" in metrics[-1]) == (name in WITH_SCALE)
    assert metrics[-1]["skipped_steps"] == 0


@pytest.mark.parametrize("name", KINDS)
def test_riding_trains_and_is_evaluated(tmp_path, name):
    settings = {**RIDING, "total_frames": 2 * 64, "estimator.name": name, "env.num_envs": 8, "ppo.critic_cells": [8]}
    settings |= {"estimator.shared": name == "memory", "estimator.actor_reads_scale": name == "unsure"}
    Trainer(make_config({**settings, "ppo.actor_cells": [16], "roa.latent_features": 4}), tmp_path).train()
    config, _, networks, _ = load_run(tmp_path, num_envs=1)
    policy = networks.deployed_policy()
    assert not any("privileged" in key for key in policy.in_keys)
    result = evaluate_tracking(policy, partial(make_env, config, **DEPLOYMENT_OVERRIDES), ([0.0], [0.0]), 2, 0.2, 0.0)
    assert result.estimators.extrinsic.shape == (1, 1, 2, 16)


def test_a_collector_carries_the_memory_from_batch_to_batch_and_drops_it_at_resets(tmp_path):
    trainer = Trainer(make_config(SMALL), tmp_path, make_env=make_cart, make_networks=partial(networks_for, "gru"))
    key, before, ended = "extrinsic_estimator_state", None, 0
    for _ in range(3):
        batch = trainer.collection.collect().clone()
        root, after, done = batch[key], batch["next", key], batch["next", "done"].squeeze(-1)
        ended += int(done.sum())
        assert torch.equal(batch["is_init"].squeeze(-1)[:, 1:], done[:, :-1])
        carried = after[:, :-1].masked_fill(done[:, :-1, None, None], 0.0)
        assert torch.equal(root[:, 1:], carried)
        assert before is None or torch.equal(root[:, 0], before)
        before = after[:, -1].masked_fill(done[:, -1, None, None], 0.0)
    assert ended
    trainer._close()


def test_a_memory_in_other_processes(tmp_path):
    config = make_config({**SMALL, "compute.collector": "process", "compute.workers": 2, "total_frames": 60})
    trainer = Trainer(config, tmp_path, make_env=make_cart, make_networks=partial(networks_for, "gru"))
    trainer.train()
    assert trainer.iteration == 2


def test_the_actor_knows_how_sure_the_estimates_are(learner_of):
    learner, env = learner_of("gaussian", scale=True)
    batch = collected(learner.networks, env, "mixed")
    student, scale = batch["act", "student"], batch["act", "extrinsic_scale"]
    assert bool((scale[student] > 0).all())
    assert not scale[~student].any()
    with pytest.raises(AssertionError, match=r"'mlp' estimates no standard deviations; take one that does"):
        small_networks(env, "mlp", scale=True)


def test_an_actor_that_reads_scales_is_symmetric():
    """The mirrored robot, as sure of the mirrored estimates, acts mirrored."""
    env = make_cart(6)
    flip, same = -torch.eye(1), torch.eye(1)
    reflections = {
        "observation": -torch.eye(2),
        ("privileged", "intrinsic"): same,
        ("privileged", "extrinsic"): flip,
        "action": flip,
    }
    networks = make_networks(
        env.observation_spec,
        env.action_spec,
        estimator="gaussian",
        latent_features=2,
        actor_cells=(8, 8),
        critic_cells=(8,),
        reflections=reflections,
        actor_reads_scale=True,
    )
    entries = [torch.randn(5, size) for size in (2, 2, 1)] + [torch.rand(5, size) for size in (2, 1)]
    observation, latent, extrinsic, latent_scale, extrinsic_scale = entries
    mirrored = (-observation, latent.flip(-1), -extrinsic, latent_scale.flip(-1), extrinsic_scale)
    torch.testing.assert_close(networks.backbone(*mirrored), -networks.backbone(*entries))
    assert not torch.allclose(networks.backbone(*entries[:3], *(2 * each for each in entries[3:])), entries[0][:, :1])


def test_a_second_policy_brings_the_state_that_the_env_lacks():
    env = make_cart(6)
    for reads in (["extrinsic"], ["latent", "extrinsic"]):
        networks = make_networks(env.observation_spec, env.action_spec, estimator="gru", actor_reads=reads)
        env = with_state(env, policy := networks.deployed_policy())
        assert env.rollout(9, policy, break_when_any_done=False)["is_init"].any()


def test_a_state_of_another_size_is_refused():
    env = make_cart(6)
    for size, message in ((4, None), (5, "state 'intrinsic_estimator_state' of another size")):
        networks = make_networks(
            env.observation_spec, env.action_spec, estimator="gru", estimator_kwargs={"features": size}
        )
        if message is None:
            with_state(env, networks.deployed_policy())
        else:
            with pytest.raises(ValueError, match=message):
                with_state(env, networks.deployed_policy())
    bare = CartEnv(3)
    assert with_state(bare, small_networks(bare, "mlp").deployed_policy()) is bare

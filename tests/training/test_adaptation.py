"""Every way of adaptation: what trains what, the first importance ratio, resume, and what can be deployed."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from tests.training.cart import make_cart
from tests.training.states import SMALL as RIDING
from tests.training.states import differing
from torchrl_atr.cli import main
from torchrl_atr.evaluation import evaluate_tracking
from torchrl_atr.modules import make_networks
from torchrl_atr.training import (
    DEPLOYMENT_OVERRIDES,
    ConfigError,
    Learner,
    Trainer,
    load_checkpoint,
    load_run,
    make_config,
    make_env,
)

SMALL = {
    "env.num_envs": 6,
    "ppo.rollout_steps": 5,
    "total_frames": 4 * 30,
    "compute.num_threads": 1,
    "compute.torch_threads": 1,
    "ppo.minibatches": 2,
}
ACTOR, ESTIMATORS = {"backbone", "exploration"}, {"intrinsic_estimator", "extrinsic_estimator"}
WITH_PPO = {  # networks that the policy's loss trains, beside actor and critic, and those that the estimators' does
    "default": ({"encoder"}, ESTIMATORS),
    "teacher": ({"encoder"}, ESTIMATORS),  # whose loss is not asked for
    "concurrent": (set(), {"extrinsic_estimator"}),
    "asymmetric": (set(), set()),
}
STUDENTS = ["rma", "distillation"]


def config_of(preset, **more):
    return make_config({**SMALL, "preset": preset, **more})


def networks_of(config, env):
    return make_networks(
        env.observation_spec,
        env.action_spec,
        estimator="mlp",
        estimator_kwargs={"cells": [4]},
        latent_features=2,
        actor_cells=(8,),
        critic_cells=(8,),
        actor_reads=config.roa.actor_reads,
    )


def cart_learner(preset, **more):
    torch.manual_seed(0)
    env, config = make_cart(6), config_of(preset, **more)
    learner = Learner(networks_of(config, env), config)
    with torch.no_grad():
        batch = env.rollout(5, learner.networks.rollout_policy(config.roa.act_source), break_when_any_done=False)
    return learner, batch


def touched(networks):
    """Networks in which some gradient is not zero."""
    found = {name: getattr(networks, name) for name in ["encoder", "critic", *ACTOR, *ESTIMATORS]}
    return {
        name
        for name, network in found.items()
        if network is not None and any(p.grad is not None and p.grad.any() for p in network.parameters())
    }


def routes(networks, terms):
    """Networks that the sum of the losses reaches; those that each loss reaches alone are checked in test_roa."""
    networks.zero_grad()
    losses = [value for name, value in terms.items() if name.startswith("loss_")]
    if losses:
        sum(losses).backward()
    return touched(networks)


@pytest.mark.parametrize("preset", WITH_PPO)
def test_ppo_has_ratio_one_at_first_and_each_loss_reaches_its_networks_alone(preset):
    learner, batch = cart_learner(preset)
    policy, adaptation = WITH_PPO[preset]
    with torch.no_grad():
        learner.advantage(batch)
        batch["previous_mean"] = batch["loc"] + 1.0
        for parameter in learner.networks.estimator_parameters():
            parameter.mul_(1.5).add_(0.1)
    terms = learner.loss.policy_loss(batch.reshape(-1)[::2])
    assert float(terms["max_ratio"]) == pytest.approx(1.0, abs=1e-4)
    assert float(terms["clip_fraction"]) == 0
    assert ("loss_roa" in terms) == ("encoder" in policy)
    assert routes(learner.networks, terms) == policy | ACTOR | {"critic"}
    assert routes(learner.networks, learner.loss.adaptation_loss(batch.reshape(-1))) == adaptation
    assert len({*learner.loss.in_keys}) == len(learner.loss.in_keys)
    assert set(learner.loss(batch.reshape(-1)).keys()) - {"explained_variance"} == set(learner.loss.out_keys)


def test_imitation_is_regression_on_the_teachers_actions_and_reaches_the_actor_alone():
    learner, batch = cart_learner("distillation")
    flat = batch.reshape(-1)
    learner.teacher.label(flat, 7)
    on_truth = learner.networks.rollout_policy("privileged")(flat.clone())["loc"]
    torch.testing.assert_close(flat["teacher_mean"], on_truth.detach())
    terms = learner.loss.policy_loss(flat.select(*learner.loss.policy_in_keys, strict=False))
    torch.testing.assert_close(terms["loss_imitation"], (flat["loc"] - on_truth).square().sum(-1).mean())
    assert routes(learner.networks, terms) == {"backbone"}
    assert routes(learner.networks, learner.loss.adaptation_loss(flat)) == ESTIMATORS
    with pytest.raises(KeyError, match="no mean action of a teacher"):
        learner.loss.policy_loss(batch)


@pytest.mark.parametrize(
    ("preset", "trained"),
    [
        ("teacher", {*ACTOR, "encoder", "critic"}),
        ("rma", ESTIMATORS),
        ("distillation", {*ESTIMATORS, "backbone"}),
    ],
)
def test_a_phase_changes_what_it_trains_and_nothing_else(preset, trained):
    learner, batch = cart_learner(preset)
    parameters = dict(learner.networks.named_parameters())
    before = {name: value.clone() for name, value in learner.networks.state_dict().items()}
    for progress in (0.5, 1.0):
        learner.anneal(progress)
        metrics = learner.update(batch.clone())
    assert not metrics.get("loss_roa", 0.0)  # a teacher is not pulled to estimates
    after = learner.networks.state_dict()
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert {name.split(".")[0] for name in changed & parameters.keys()} == trained
    assert bool(changed - parameters.keys()) == (preset != "rma")  # normalisers are part of a policy
    if learner.teacher is not None:
        assert differing(dict(learner.teacher.networks.state_dict()), before) == []
    if preset == "rma":
        assert all(torch.equal(learner.deployed.state_dict()[name], before[name]) for name in before.keys() - changed)


def test_the_student_comes_closer_to_its_teacher():
    learner, batch = cart_learner("distillation", **{"ppo.learning_rate": 2e-3})
    losses = [learner.update(batch.clone())["loss_imitation"] for _ in range(20)]
    assert losses[-1] < 0.5 * losses[0]


@pytest.mark.parametrize("preset", ["concurrent", "asymmetric", "teacher"])
def test_it_goes_on_bit_for_bit(tmp_path, preset):
    _check_resume(tmp_path, preset)
    if preset == "teacher":  # and the students that begin from it
        for student in STUDENTS:
            _check_resume(tmp_path / student, student, tmp_path / "straight")


def _check_resume(folder, preset, start=None):
    config = config_of(preset)
    make = {"make_env": make_cart, "make_networks": partial(networks_of, config)}
    Trainer(config, folder / "straight", begin_from=start, **make).train()
    Trainer(config, folder / "halves", begin_from=start, **make).train(lambda metrics: metrics["iteration"] == 2)
    state = load_checkpoint(folder / "halves")
    Trainer(config, folder / "halves", state, **make).train()
    ends = [load_checkpoint(folder / name) for name in ("straight", "halves")]
    for end in ends:
        for clock in ("seconds", "provenance", "best_reward"):
            del end[clock]
    assert differing(*ends) == []
    if preset == "distillation":
        assert differing(ends[0]["learner"]["teacher"], load_checkpoint(start)["learner"]["deployed"]) == []


@pytest.mark.parametrize(
    ("preset", "reads"),
    [
        ("concurrent", {"observation", "history", "dead_reckoned_velocity"}),
        ("asymmetric", {"observation", "history"}),
    ],
)
def test_riding_trains_and_is_evaluated(tmp_path, preset, reads):
    metrics = []
    Trainer(make_config({**RIDING, "total_frames": 64, "preset": preset}), tmp_path).train(metrics.append)
    assert metrics[0]["skipped_steps"] == 0
    config, _, networks, _ = load_run(tmp_path, num_envs=1)
    policy = networks.deployed_policy()
    assert set(policy.in_keys) == reads
    assert networks.encoder_module is None
    result = evaluate_tracking(policy, partial(make_env, config, **DEPLOYMENT_OVERRIDES), ([0.0], [0.0]), 2, 0.2, 0.0)
    assert (result.estimators is None) == (preset == "asymmetric")


def test_two_phases_by_the_command_line(tmp_path, capsys):
    sizes = {**RIDING, "total_frames": 64, "ppo.gamma": 0.9}
    words = [word for path, value in sizes.items() for word in (f"--{path.replace('_', '-')}", str(value))]
    teacher, student = str(tmp_path / "teacher"), str(tmp_path / "rma")
    assert main(["train", "--preset", "teacher", "--output", teacher, *words]) == 0
    assert f"evaluate {teacher} --act-source privileged" in capsys.readouterr().out
    for command in ("evaluate", "play", "export"):
        more = ["--output", str(tmp_path / "bundle")] if command == "export" else []
        assert main([command, teacher, *more]) == 2
        assert "this policy is a teacher" in capsys.readouterr().err
    assert main(["train", "--preset", "paper", "--from", teacher, "--output", student]) == 2
    assert "second phase: distillation, rma" in capsys.readouterr().err
    assert main(["train", "--preset", "rma", "--from", teacher, "--output", student]) == 0
    config, _, networks, state = load_run(student, num_envs=1)
    assert (config.preset, config.ppo.gamma, config.roa.act_source) == ("rma", 0.9, "estimated")
    assert "privileged" not in str(networks.deployed_policy().in_keys)
    learned = load_checkpoint(teacher)["learner"]["deployed"]
    for name, value in state["learner"]["deployed"].items():
        assert torch.equal(value, learned[name]) == (".net." not in name or "estimator" not in name), name


@pytest.mark.parametrize("preset", STUDENTS)
def test_a_student_without_a_teacher_is_refused(tmp_path, preset):
    with pytest.raises(ConfigError, match=r"needs a trained policy: train one with --preset teacher"):
        Trainer(config_of(preset), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("setting", ["ppo.tracking_errors", "estimator.dead_reckoning", "estimator.shared"])
def test_what_needs_an_estimate_that_is_not_read_is_refused(setting):
    off = dict.fromkeys(["ppo.tracking_errors", "estimator.dead_reckoning"], False) | {"env.reposition_feet": 0.0}
    with pytest.raises(ConfigError, match=rf"{setting}=true needs an estimate .*or set {setting}=false"):
        config_of("default", **{**off, "roa.actor_reads": ("latent",), setting: True})
    assert config_of("default", **off, **{"roa.actor_reads": ("latent",)}).roa.actor_reads == ("latent",)

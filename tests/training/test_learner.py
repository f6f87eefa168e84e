"""The learner's schedules over a run, and the steps of an iteration."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch.utils._python_dispatch import TorchDispatchMode

from torchrl_atr._compilation import compiler
from torchrl_atr.training import (
    ConfigError,
    Learner,
    make_config,
    make_env,
    make_policy,
    make_reward_schedule,
    make_run_networks,
)


def small_learner(settings=None):
    config = make_config(
        {"env.num_envs": 2, "ppo.rollout_steps": 2, "compute.num_threads": 1, "ppo.minibatches": 1, **(settings or {})}
    )
    env = make_env(config)
    return Learner(make_run_networks(config, env), config, reward_schedule=make_reward_schedule(env)), env


def rolled_out(learner, env, steps=2):
    """A batch of the learner's policy."""
    with torch.no_grad():
        policy = learner.networks.rollout_policy(learner.config.roa.act_source)
        return env.rollout(steps, policy, break_when_any_done=False)


@pytest.mark.parametrize("ramp", [False, True])
def test_exploration_and_kl_target_sink_late_and_the_ramp_is_the_ancestors(ramp):
    anneal = {
        "exploration.anneal_from": 0.4,
        "exploration.anneal_until": 0.8,
        "exploration.init_std": 0.3,
        "exploration.final_std": 0.1,
    }
    learner, _ = small_learner(
        {**anneal, "ppo.target_kl": 0.03, "ppo.final_kl": 0.01, "roa.coeff": 0.2, "roa.ramp": ramp}
    )
    half = 0.3 / 3**0.5, 0.02
    for progress, ceiling, kl in ((0.0, 0.3, 0.03), (0.4, 0.3, 0.03), (0.6, *half), (0.8, 0.1, 0.01), (1.2, 0.1, 0.01)):
        learner.anneal(progress)
        assert float(learner.networks.exploration.std().detach().max()) == pytest.approx(ceiling, abs=1e-5)
        assert learner.schedule.target_kl == pytest.approx(kl)
        expected = 0.2 * min(progress, 1.0) if ramp else 0.2
        assert float(learner.loss.roa_coeff) == pytest.approx(expected)
    assert torch.isfinite(learner.networks.exploration.raw).all()


@pytest.mark.parametrize(("final", "last"), [(1.0, 2.0), (3.0, 3.5), (5.0, 5.0)])
def test_r1_counts_more_until_the_noise_has_sunk_and_the_terms_stay(final, last):
    learner, env = small_learner(
        {
            "env.num_envs": 4,
            "task.steering_weight_peak": 5,
            "task.steering_weight_end": final,
            "task.steadiness": 0.0,
            "task.fall_weight": 1.0,
            "exploration.anneal_until": 0.8,
        }
    )
    batch, rewards, advantage = rolled_out(learner, env), [], learner.advantage
    learner.advantage = lambda data: (rewards.append(data["next", "reward"].clone()), advantage(data))[1]
    plain, steering = batch["next", "reward"].clone(), batch["next", "reward_terms", "steering_command"].clone()
    for progress in (0.0, 0.2, 0.8, 0.95):
        learner.anneal(progress)
        learner.update(batch.clone())
    for seen, count in zip(rewards, (1.0, 2.0, 5.0, last), strict=True):
        torch.testing.assert_close(seen, plain + (count - 1.0) * steering)
    assert torch.equal(batch["next", "reward_terms", "steering_command"], steering)


def test_terms_count_as_scheduled_and_a_missing_one_is_named():
    learner, env = small_learner()
    batch, seen, advantage = rolled_out(learner, env), [], learner.advantage
    learner.advantage = lambda data: (seen.append(data["next", "reward"].clone()), advantage(data))[1]
    terms, plain = batch["next", "reward_terms"], batch["next", "reward"].clone()
    scheduled, other, *_ = terms.keys()
    learner.reward_schedule = {scheduled: lambda progress: 3.0 * progress, other: lambda progress: 1.0}
    for progress in (0.0, 0.5, 2.0):
        learner.anneal(progress)
        learner.update(batch.clone())
    for reward, factor in zip(seen, (0.0, 1.5, 3.0), strict=True):
        torch.testing.assert_close(reward, plain + (factor - 1.0) * terms[scheduled])
    learner.reward_schedule = {"no_such_term": lambda progress: 1.0}
    learner.anneal(0.0)
    with pytest.raises(
        ConfigError, match=r"names the term 'no_such_term', but the env's reward_terms are .*leave it out"
    ):
        learner.update(batch.clone())


def test_advantages_by_hand():
    """A critic that says 10 everywhere: the errors are r + 0.9 x 10 - 10, their sum decays by 0.9 x 0.5 a step."""
    learner, env = small_learner({"ppo.rollout_steps": 3, "ppo.gamma": 0.9, "ppo.gae_lambda": 0.5})
    last = learner.networks.critic.net[-1]
    for parameter in last.parameters():
        torch.nn.init.zeros_(parameter)
    batch = rolled_out(learner, env, 3)
    torch.nn.init.constant_(last.even.bias, 10.0 / learner.networks.critic.scale)
    ended = torch.tensor([[0, 0, 0], [0, 1, 0]], dtype=torch.bool).unsqueeze(-1)
    batch["next"].update({"done": ended, "terminated": ended, "truncated": torch.zeros_like(ended)})
    batch["next", "reward"] = torch.tensor([[1.0, 2.0, 4.0], [1.0, 1.0, 1.0]]).unsqueeze(-1)
    with torch.no_grad():
        learned = learner.advantage(batch)
    errors = torch.tensor([[0.45 * 2.35, 1.0 + 0.45 * 3.0, 3.0], [0.45 * -9.0, -9.0, 0.0]])  # one fell: 1 - 10
    torch.testing.assert_close(learned["value_target"].squeeze(-1), 10.0 + errors)
    torch.testing.assert_close(learned["advantage"].squeeze(-1), (errors - errors.mean()) / errors.std(correction=0))


def test_the_rate_stays_once_a_policy_has_gone_too_far():
    """It has been lowered once for that, by 1.5, and one step of Adam, as large as the rate, was taken before."""
    learner, env = small_learner(
        {"ppo.rollout_steps": 4, "ppo.minibatches": 4, "ppo.epochs": 1, "ppo.learning_rate": 3e-4, "ppo.kl_stop": 5.0}
    )
    weight, divergences = next(learner.networks.backbone.parameters()), iter([0.0, 1.0, 1.0, 1.0])
    start = weight.detach().clone()

    def diverging(_):
        terms = {"mean_ratio": torch.tensor(1.0), "kl_approx": torch.tensor(next(divergences))}
        return TensorDict({**terms, "loss_objective": weight.sum()})

    learner.loss.policy_loss = diverging
    assert learner.update(rolled_out(learner, env, 4))["learning_rate"] == pytest.approx(2e-4)
    torch.testing.assert_close(weight.detach(), start - 3e-4, atol=1e-7, rtol=0.0)


def test_a_huge_gradient_is_clipped_for_policy_and_critic_apart():
    learner, env = small_learner({"ppo.max_grad_norm": 0.5})
    groups = [learner._groups[name] for name in ("policy", "critic")]

    def steep(_):
        terms = {"mean_ratio": torch.tensor(1.0), "kl_approx": torch.tensor(0.0)}
        slopes = [sum(parameter.sum() for parameter in group) for group in groups]
        return TensorDict({**terms, "loss_objective": 1e6 * slopes[0], "loss_critic": 1e3 * slopes[1]})

    learner.loss.policy_loss = steep
    learner.update(rolled_out(learner, env))
    for group in groups:
        norm = torch.stack([parameter.grad.norm() for parameter in group]).norm()
        assert norm.item() == pytest.approx(0.5, rel=1e-4)


def updates(learner, env, times):
    """After each of so many iterations, a copy of the networks' state."""
    states = []
    for _ in range(times):
        learner.update(rolled_out(learner, env))
        states.append({name: value.clone() for name, value in learner.networks.state_dict().items()})
    return states


def test_deployed_are_the_running_mean_of_the_weights_and_the_last_statistics():
    learner, env = small_learner({"ppo.ema_horizon": 2})
    states = updates(learner, env, 12)
    shares = [1.0, *(max(1 / 2, 9 / (10 + iteration)) for iteration in range(1, 12))]
    assert shares[1] == 9 / 11
    assert shares[-1] == 1 / 2
    weights = {name for name, _ in learner.networks.named_parameters()}
    for name, deployed in learner.deployed.state_dict().items():
        expected = states[0][name]
        for share, state in zip(shares[1:], states[1:], strict=True):
            expected = torch.lerp(expected, state[name], share) if name in weights else state[name]
        torch.testing.assert_close(deployed, expected)
    trained = {id(parameter) for group in learner._groups.values() for parameter in group}
    assert trained.isdisjoint(map(id, learner.deployed.parameters()))


def test_a_mean_over_one_iteration_is_the_last_weights():
    learner, env = small_learner({"ppo.ema_horizon": 1})
    *_, last = updates(learner, env, 3)
    for name, value in learner.deployed.state_dict().items():
        assert torch.equal(value, last[name]), name


def test_a_learner_of_before_there_was_a_mean_deploys_its_networks():
    (one, _), (other, _) = small_learner(), small_learner()
    state = one.state_dict()
    del state["deployed"], state["averaged"]
    other.load_state_dict(state)
    for name, value in one.networks.state_dict().items():
        assert torch.equal(other.deployed.state_dict()[name], value), name


@pytest.mark.skipif(compiler() is None, reason="no C++ compiler on PATH")
def test_compiled_losses_and_policy_do_what_the_eager_ones_do_schedules_included():
    still = dict.fromkeys(("ppo.learning_rate", "ppo.critic_learning_rate", "estimator.learning_rate"), 1e-9)
    settings = {
        "env.num_envs": 8,
        "ppo.rollout_steps": 4,
        "compute.num_threads": 1,
        "ppo.minibatches": 1,
        "ppo.epochs": 1,
        "roa.ramp": True,
    }
    env = make_env(make_config(settings))
    start, batch, found = env.reset(), None, {}
    torch._dynamo.utils.counters.clear()
    for compiled in (False, True):
        config = make_config({**settings, **still, "compute.compiled": compiled})
        torch.manual_seed(0)
        learner = Learner(make_run_networks(config, env), config)
        with torch.no_grad():
            acted = make_policy(config, learner.networks)(start.clone())
            if batch is None:
                policy = learner.networks.rollout_policy(config.roa.act_source)
                batch = env.rollout(4, policy, auto_reset=False, tensordict=start.clone(), break_when_any_done=False)
        metrics = []
        for progress in (0.25, 0.75):
            learner.anneal(progress)
            metrics.append(learner.update(batch.clone()))
        gradients = {name: weight.grad for name, weight in learner.networks.named_parameters()}
        found[compiled] = {"action": acted["action"], **gradients}, metrics
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] >= 4  # policy, critic, both losses
    assert not torch._dynamo.utils.counters["graph_break"]
    (wanted, plain), (tensors, metrics) = found[False], found[True]
    assert plain[1]["loss_roa"] > 2.5 * plain[0]["loss_roa"] > 0.0
    for ours, theirs in zip(metrics, plain, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-3, abs=1e-5)
    for name, tensor in tensors.items():
        torch.testing.assert_close(tensor, wanted[name], atol=1e-5, rtol=1e-3, msg=lambda m, name=name: f"{name}: {m}")


class Looks(TorchDispatchMode):
    """Counts what would wait for a GPU: values that Python asks for, results whose size depends on values."""

    def __init__(self):
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        self.count += function.overloadpacket.__name__ in ("_local_scalar_dense", "nonzero", "masked_select")
        return function(*args, **(kwargs or {}))


def test_no_optimiser_step_and_no_policy_step_looks_at_values():
    looks = []
    for epochs in (1, 4):
        settings = {"env.num_envs": 8, "ppo.rollout_steps": 4, "compute.num_threads": 1, "ppo.minibatches": 2}
        config = make_config({**settings, "ppo.epochs": epochs, "estimator.epochs": epochs})
        env = make_env(config)
        learner = Learner(make_run_networks(config, env), config)
        policy = make_policy(config, learner.networks)
        with torch.no_grad():
            batch = env.rollout(4, policy, break_when_any_done=False)
            with Looks() as acting:
                policy(batch[:, 0].clone())
        assert acting.count == 0
        learner.update(batch.clone())  # what happens once in a run
        with Looks() as learning:
            learner.update(batch.clone())
        looks.append(learning.count)
    assert looks[0] == looks[1] > 0

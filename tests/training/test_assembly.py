"""The env and the networks that a configuration describes, in training and deployed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor, TanhNormal

from torchrl_atr.modules import CorrelatedGaussian, NetworkKeys, hadamard_leg_basis, make_networks
from torchrl_atr.training import (
    DEPLOYMENT_OVERRIDES,
    ConfigError,
    make_config,
    make_env,
    make_policy,
    make_run_loss,
    make_run_networks,
)
from torchrl_atr.training.assembly import TIME_LIMIT_CHECK_INTERVAL

TRUTH = {("privileged", "intrinsic"), ("privileged", "extrinsic")}
CONFIG = make_config(
    {"env.num_envs": 64, "curriculum.max_speed": 3.0, "curriculum.max_yaw_rate": 1.0, "compute.num_threads": 1}
)


def test_training_starts_at_staggered_times_and_within_the_bounds():
    env = make_env(CONFIG)
    assert env.curriculum.grid.bounds == (3.0, 1.0)
    assert env.reset()["step_count"].unique().numel() > 8


def test_robots_reach_their_time_limits_together():
    short = {"env.episode_seconds": 0.4, "curriculum.command_seconds": 0.4, "curriculum.score_from_seconds": 0.0}
    data = make_env(make_config({**short, "env.num_envs": 16, "compute.num_threads": 1})).rollout(
        60, break_when_any_done=False
    )
    ends = data["next", "truncated"].squeeze(-1).any(0).nonzero().squeeze(-1) + 1
    assert len(ends) > 2
    assert not (ends % TIME_LIMIT_CHECK_INTERVAL).any()


def test_a_deployed_policy_starts_at_the_beginning_and_takes_any_command():
    env = make_env(CONFIG, num_envs=2, **DEPLOYMENT_OVERRIDES)
    env.curriculum.pin(torch.tensor([15.0, -2.0]))
    start = env.reset()
    assert env.curriculum.command.tolist() == [[15.0, -2.0]] * 2
    assert not start["command"].any()  # which approaches it
    assert not start["step_count"].any()


@pytest.mark.parametrize(("largest", "bounds"), [(0.0, (1.5, 1.0)), (2.0, (2.0, 1.0)), (1.0, (1.5, 1.0))])
def test_a_deployed_walker_takes_the_task_s_commands_and_those_it_was_trained_for(largest, bounds):
    config = make_config(
        {"task.name": "walking", "env.num_envs": 1, "curriculum.max_speed": largest, "compute.num_threads": 1}
    )
    assert make_env(config).curriculum.grid.bounds == (largest or 1.5, 1.0)
    grid = make_env(config, **DEPLOYMENT_OVERRIDES).curriculum.grid
    assert grid.bounds == bounds
    assert grid.forward_only


def test_a_part_that_the_task_does_not_have_is_refused_and_its_default_ignored():
    config = make_config(
        {"task.name": "walking", "task.transporter": "single_board", "env.num_envs": 1, "compute.num_threads": 1}
    )
    assert "transporter" not in config.make_task().arguments
    with pytest.raises(ConfigError, match="transporter='two_board': the task 'walking' has no transporter; leave it"):
        make_env(config, transporter="two_board", **DEPLOYMENT_OVERRIDES)


@pytest.mark.parametrize(
    ("settings", "policy", "critic"),
    [
        ({}, {"dead_reckoned_velocity"}, TRUTH | {("privileged", "tracking_forecast")}),
        ({"estimator.dead_reckoning": False, "ppo.tracking_forecast": False}, set(), TRUTH),
        ({"ppo.privileged_critic": False}, {"dead_reckoned_velocity"}, set()),
    ],
)
def test_settings_say_what_networks_read(settings, policy, critic):
    config = make_config({"env.num_envs": 2, "compute.num_threads": 1, "ppo.critic_cells": [8], **settings})
    networks = make_run_networks(config, make_env(config))
    assert set(networks.deployed_policy().in_keys) == {"observation", "history"} | policy
    assert set(networks.critic_module.in_keys) == {"observation"} | critic


def test_outputs_move_directions_of_exploration_with_the_gains_of_their_first_variances():
    config = make_config(
        {"env.num_envs": 1, "exploration.init_std": 0.3, "exploration.relative_std": 0.1, "compute.num_threads": 1}
    )
    networks, basis = make_run_networks(config, make_env(config)), hadamard_leg_basis()
    assert torch.equal(networks.exploration.basis, basis)
    torch.testing.assert_close(networks.exploration.std(), torch.tensor([0.3] * 3 + [0.1] * 9))
    gains = torch.tensor([0.3] * 3 + [0.1**2 / 0.3] * 9)
    torch.testing.assert_close(networks.backbone.output_map, gains.unsqueeze(-1) * basis.T)


def test_a_custom_distribution_samples_itself():
    config = make_config({"env.num_envs": 2, "compute.num_threads": 1, "ppo.actor_cells": [8], "ppo.critic_cells": [8]})
    networks = make_run_networks(config, make_env(config))
    ours = networks.rollout_policy("privileged")
    assert isinstance(make_policy(config, networks)[-1], CorrelatedGaussian)
    bounded = ProbabilisticActor(
        TensorDictModule(
            lambda observation: (observation[:, :12], torch.ones(2, 12)), ["observation"], ["loc", "scale"]
        ),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    custom = SimpleNamespace(rollout_policy=lambda source: bounded)
    assert make_policy(make_config({"compute.compiled": False}), custom) is bounded
    assert ours.module[-1].distribution_class is not TanhNormal


def test_renamed_entries_reach_the_policy_and_the_loss():
    config = make_config({"env.num_envs": 2, "compute.num_threads": 1, "ppo.actor_cells": [8], "ppo.critic_cells": [8]})
    env = make_env(config)
    keys = NetworkKeys(action="act_", latent="z", extrinsic=("privileged", "extrinsic"), state_value="v")
    networks = make_networks(env.observation_spec, env.action_spec, keys=keys)
    assert make_policy(make_config({"compute.compiled": False}), networks).out_keys[-2:] == ["act_", "act__log_prob"]
    loss = make_run_loss(config, networks)
    assert (loss.tensor_keys.latent, loss.tensor_keys.value) == ("z", "v")
    assert (loss.tensor_keys.action, loss.tensor_keys.sample_log_prob) == ("act_", "act__log_prob")

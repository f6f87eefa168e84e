"""Gain of the commands: neutral at first, positive, even in the command, and trained apart from the network."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.modules import ActorBackbone, CommandGain, RunningNormalizer
from torchrl_atr.training import Learner, make_config
from torchrl_atr.training.assembly import make_env, make_run_networks
from torchrl_atr.training.optimizers import parameter_groups

SMALL = {"env.num_envs": 2, "ppo.rollout_steps": 4, "compute.num_threads": 1, "task.robot": "a1"}


def trained_gain() -> CommandGain:
    gain = CommandGain([1, 2])
    with torch.no_grad():
        gain.bias.copy_(torch.tensor([0.1, -0.2]))
        gain.weight.copy_(torch.tensor([[0.3, 0.0], [0.0, 0.6]]))
    return gain


def test_it_changes_nothing_at_first():
    observation = torch.randn(5, 4)
    assert torch.equal(CommandGain([1, 2])(observation), observation)


def test_values_by_hand_and_only_the_commands_change():
    observation = torch.tensor([7.0, 1.0, -2.0, 9.0])
    expected = [7.0, 1.0 * torch.tensor(0.1 + 0.3 / 2).exp(), -2.0 * torch.tensor(-0.2 + 0.6 * 2 / 3).exp(), 9.0]
    torch.testing.assert_close(trained_gain()(observation), torch.tensor(expected))


def test_opposite_commands_have_the_same_gain():
    command = torch.randn(6, 2)
    torch.testing.assert_close(trained_gain().gain(command), trained_gain().gain(-command))


def test_entries_must_be_consecutive():
    with pytest.raises(ValueError, match=r"entries=\[0, 2\] of the command must be consecutive"):
        CommandGain([0, 2])


def test_the_actor_reads_products_and_errors_of_the_changed_command():
    options = {"input_products": [(1, 2)], "input_errors": [(1, 0)]}
    parts = RunningNormalizer(4), RunningNormalizer(1), 1, 2
    torch.manual_seed(0)
    plain = ActorBackbone(*parts, **options)
    torch.manual_seed(0)
    gained = ActorBackbone(*parts, **options, command_gain=trained_gain())
    observation, latent, extrinsic = torch.randn(5, 4), torch.randn(5, 1), torch.randn(5, 1)
    torch.testing.assert_close(
        gained(observation, latent, extrinsic), plain(trained_gain()(observation), latent, extrinsic)
    )


@pytest.mark.parametrize("rate", [0.0, 1e-3])
def test_its_parameters_have_an_optimiser_of_their_own(rate):
    config = make_config({**SMALL, "ppo.command_gain_rate": rate})
    networks = make_run_networks(config, make_env(config))
    groups = parameter_groups(networks)
    assert ("command_gain" in groups) == bool(rate)
    everything = [id(parameter) for group in groups.values() for parameter in group]
    assert sorted(everything) == sorted({id(parameter) for parameter in networks.parameters()})
    if rate:
        learner = Learner(networks, config)
        assert learner.optimizers["command_gain"].param_groups[0]["lr"] == rate
        assert sum(each.numel() for each in groups["command_gain"]) == 6

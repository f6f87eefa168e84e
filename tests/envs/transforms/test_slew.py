"""Commands that approach their target at a limited rate: closed form, starts, partial resets."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv, check_env_specs
from torchrl.envs.transforms import Compose

from torchrl_atr.envs import make_riding_env
from torchrl_atr.envs.transforms import CommandCurriculum, CommandSlew
from torchrl_atr.envs.transforms.slew import slew

from .toy import ToyEnv

RATES = (3.0, 1.5)  # a step of 0.02 s changes the command by 0.06 m/s and 0.03 rad/s


def ride(env, steps):
    """Return the commands in force of ``steps`` steps, (N, T, 2)."""
    return env.rollout(steps, lambda td: td.set("action", torch.zeros(env.action_spec.shape)))["command"]


def test_a_command_approaches_in_a_straight_line_and_stays():
    env = make_riding_env(num_envs=2, num_threads=1, seed=0, command_slew=RATES)
    env.reset()
    env.curriculum.pin(torch.tensor([[0.2, -0.1], [-0.09, 0.0]]))
    line = torch.arange(8)[:, None] * torch.tensor([0.06, 0.03])
    expected = torch.stack([line.minimum(torch.tensor([0.2, 0.1])), line.minimum(torch.tensor([0.09, 0.0]))])
    assert torch.allclose(ride(env, 8), expected * torch.tensor([[[1.0, -1.0]], [[-1.0, 1.0]]]), atol=1e-6)


def test_the_robot_observes_and_is_rewarded_for_the_command_in_force():
    env = make_riding_env(num_envs=1, num_threads=1, seed=0, command_slew=RATES)
    env.curriculum.pin((2.0, 0.0))
    steps = env.rollout(4, lambda td: td.set("action", torch.zeros(env.action_spec.shape)))
    assert torch.equal(steps["observation"][..., -2:], steps["command"])
    error = (steps["next", "speeds"][..., :1] - steps["command"][..., :1]).abs()
    r1 = steps["next", "reward_terms", "forward_command"]
    assert torch.allclose(r1, 8.0 * 0.02 * torch.exp(-error / 0.5), atol=1e-5)


def test_rows_that_start_on_the_move_have_reached_their_command():
    env = make_riding_env(num_envs=64, num_threads=1, seed=0, command_slew=RATES, moving_start=0.5)
    first = env.reset()
    moving = first["moving_start"].squeeze(-1)
    assert 0 < moving.sum() < 64
    assert torch.equal(first["command"][moving], env.curriculum.command[moving])
    assert not first["command"][~moving].any()


def test_a_reset_of_some_rows_leaves_the_others_on_their_way():
    env = make_riding_env(num_envs=3, num_threads=1, seed=0, command_slew=RATES)
    env.curriculum.pin((2.0, 1.0))
    env.reset()
    last = env.rollout(5, lambda td: td.set("action", torch.zeros(env.action_spec.shape)))[:, -1]["next"]
    last["_reset"] = torch.tensor([[False], [True], [False]])
    for key in ("done", "terminated", "truncated"):
        last[key] = last["_reset"].clone()
    assert torch.allclose(env.reset(last)["command"][:, 0], torch.tensor([0.3, 0.0, 0.3]))


def test_specs_hold_and_compact_storage_changes_nothing():
    plain, compact = (
        make_riding_env(num_envs=2, num_threads=1, seed=0, command_slew=RATES, compact_storage=compact)
        for compact in (False, True)
    )
    assert torch.equal(ride(plain, 6), ride(compact, 6))
    check_env_specs(plain)


def test_alone_around_an_env_of_ones_own():
    commands = CommandCurriculum((1.0, 1.0), seed=0), CommandSlew((1.0, 1.0), dt=0.1)
    env = TransformedEnv(ToyEnv((2,)), Compose(*commands))
    env.reset()
    env.transform[0].pin((0.35, -2.0))
    commands = env.rollout(5)["command"][0]
    assert torch.allclose(commands[1:, 0] - commands[:-1, 0], torch.tensor([0.1, 0.1, 0.1, 0.05]), atol=1e-6)
    assert torch.allclose(commands[:, 1], -0.1 * torch.arange(5), atol=1e-6)


def test_slew_is_idempotent_on_what_is_slow_enough():
    step, target = torch.tensor([0.06, 0.03]), torch.tensor([[2.0, -0.5]])
    command, again = torch.zeros(2, 1, 2)
    for _ in range(50):
        command = slew(command, target, step)
        again = slew(again, command, step)
        assert torch.equal(command, again)
    assert torch.equal(command, target)


@pytest.mark.parametrize("rates", [(0.0, 1.0), (1.0,), "fast"])
def test_bad_rates(rates):
    with pytest.raises(ValueError, match="rates must be two positive numbers"):
        CommandSlew(rates)


def test_it_belongs_to_an_env():
    with pytest.raises(NotImplementedError, match="only works on the reset and step of an environment"):
        CommandSlew(RATES)(TensorDict({"command": torch.zeros(1, 2)}, [1]))

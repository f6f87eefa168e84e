"""Reward terms of a user's own: added, dropped, reweighted, wherever the task runs."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr._compilation import compiler
from torchrl_atr.envs import RIDING_REWARDS, RewardError, RewardTerm, RidingEnv, make_riding_env


def speed(context):
    """Return |v|, m/s."""
    return context.state.speeds[:, 0].abs()


OWN = {name: term for name, term in RIDING_REWARDS.items() if name != "postural_deviation"} | {
    "slow": RewardTerm(speed, -0.5),
    "steering_command": RIDING_REWARDS["steering_command"].weighted(20.0),
}


@pytest.mark.usefixtures("traced")
@pytest.mark.parametrize(
    "compiled", [False, pytest.param(True, marks=pytest.mark.skipif(compiler() is None, reason="no compiler"))]
)
def test_they_appear_in_specs_and_data_and_are_scored(compiled):
    env = make_riding_env(num_envs=3, num_threads=1, seed=0, rewards=OWN, compiled=compiled, moving_start=1.0)
    assert list(env.observation_spec["reward_terms"].keys()) == list(OWN)
    env.curriculum.pin((1.0, 0.5))
    steps = env.rollout(5, break_when_any_done=False)
    terms = steps["next", "reward_terms"]
    assert set(terms.keys()) == set(OWN)
    torch.testing.assert_close(terms["slow"], -0.02 * 0.5 * steps["next", "speeds"][..., :1].abs())
    torch.testing.assert_close(torch.stack(list(terms.values())).sum(0), steps["next", "reward"])
    error = (steps["next", "speeds"] - steps["command"])[..., 1:].abs()
    torch.testing.assert_close(terms["steering_command"], 0.02 * 20.0 * torch.exp(-error / 0.5))


def test_the_curriculum_follows_the_weights():
    required = make_riding_env(num_envs=1, num_threads=1, rewards=OWN).curriculum._required
    torch.testing.assert_close(required[1] / required[0], torch.tensor(20.0 / 8.0))


def test_the_curriculum_names_a_term_that_it_lacks():
    with pytest.raises(RewardError, match="the command curriculum scores the reward term 'forward_command'"):
        make_riding_env(num_envs=1, num_threads=1, rewards={"slow": OWN["slow"]})


def test_the_suite_takes_them():
    from torchrl_atr.envs import suite

    ours, plain = (suite.load(random=0, pushes=False, **rewards) for rewards in ({"rewards": OWN}, {}))
    rewards = []
    for environment in (ours, plain):
        environment.task.command = (0.0, 0.5)
        environment.reset()
        rewards.append(environment.step([0.1] * 12).reward)
    assert rewards[0] != pytest.approx(rewards[1])


def test_a_failing_simulation_costs_nothing_where_termination_was_left_out():
    env = RidingEnv(num_envs=2, num_threads=1, seed=0, rewards={"slow": OWN["slow"]})
    td = env.reset().set("action", torch.zeros(2, 12))
    env.engine.qpos[1, env.scene.layout.joint_qpos[0]] = torch.nan
    after = env.step(td)["next"]
    assert after["terminated"].tolist() == [[False], [True]]
    assert after["reward"][1].item() == 0.0


def test_what_is_no_term_is_refused():
    with pytest.raises(RewardError, match="'slow'"):
        make_riding_env(num_envs=1, num_threads=1, rewards={"slow": speed})

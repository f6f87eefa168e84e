"""Scripted steps in an env: what policy, env and collected data see of them."""

from __future__ import annotations

import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.envs import TransformedEnv, check_env_specs
from toy import ToyEnv

from torchrl_atr._errors import InputError
from torchrl_atr.envs import make_env, make_riding_env
from torchrl_atr.envs.tasks import walking
from torchrl_atr.envs.transforms import FootRepositioning

ACT = ("act", "extrinsic")


def env_of(share=0.2, num_envs=3):
    return make_riding_env(
        "a1",
        "single_board",
        num_envs=num_envs,
        seed=0,
        randomization="off",
        pushes=False,
        num_threads=1,
        reposition_feet=share,
    )


def policy(shift):
    """Hold q0, and believe that the trunk is ``shift`` metres further ahead than it is."""
    ahead = torch.zeros(16)
    ahead[13] = shift
    return TensorDictSequential(
        TensorDictModule(lambda x: x + ahead, [("privileged", "extrinsic")], [ACT]),
        TensorDictModule(lambda o: o.new_zeros(*o.shape[:-1], 12), ["observation"], ["action"]),
    )


def executed(td, env):
    sizes = env.base_env.runner.terms.observations.sizes["proprio"]
    return dict(zip(sizes, td["proprio"].split(list(sizes.values()), -1)))["action"]


def test_the_env_acts_by_the_steps_and_the_data_hold_the_policys_action():
    env = env_of()
    names = env.base_env.runner.terms.observations.names(("privileged", "extrinsic"))
    assert names[13] == "relative_position[0]"
    td = env.rollout(30, policy(0.2))
    assert not td["action"].any()
    sensed = executed(td["next"], env)
    assert sensed.abs().amax((0, 2)).gt(0.05).any()  # it was carried out, and the robot knows
    assert (td["next", "foot_steps"][..., 0] > 0).any()
    assert not executed(env.rollout(30, policy(0.0))["next"], env).any()


def test_without_what_the_policy_acts_on_actions_stay_as_they_are():
    td = env_of().rollout(20)
    assert (td["next", "foot_steps"][..., 0] == -1).all()


def test_it_keeps_the_contract_and_begins_again_where_an_episode_begins():
    env = env_of()
    check_env_specs(env)
    td = env.rollout(20, policy(0.2))[:, -1]["next"].exclude("reward")
    again = torch.tensor([[False], [True], [False]])
    begun = env.reset(td.set("_reset", again))
    assert (begun["foot_steps"][1, 0], begun["foot_steps"][1, 1:].abs().sum()) == (-1, 0)
    torch.testing.assert_close(begun["foot_steps"][[0, 2]], td["foot_steps"][[0, 2]])


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_envs_of_any_batch_shape(batch):
    class Halves:
        def start(self, robots):
            return torch.zeros(robots, 1)

        def __call__(self, action, proprio, extrinsic, state):
            assert action.ndim == 2  # robots in rows
            return action / 2, state + 1

    env = TransformedEnv(ToyEnv(batch), FootRepositioning(Halves(), extrinsic_key="command"))
    check_env_specs(env)
    td = env.reset()
    for steps in (1, 2):
        td = env.step(td.set("action", torch.ones(*batch, 1)))["next"]
        assert td["foot_steps"].tolist() == torch.full((*batch, 1), steps).tolist()


def test_off_and_wrong_thresholds():
    assert "foot_steps" not in env_of(0.0).observation_spec
    with pytest.raises(InputError, match="reposition_feet=-1"):
        env_of(-1)
    with pytest.raises(InputError, match="where feet have places on a board"):
        make_env(walking("a1"), 2, num_threads=1, reposition_feet=0.05)

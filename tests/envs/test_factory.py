"""The real env behind the standard transforms: TorchRL's own checks, partial resets, workers."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from torchrl.envs import ParallelEnv, SerialEnv
from torchrl.envs.utils import check_env_specs

from torchrl_atr.envs import make_riding_env

small = partial(make_riding_env, num_envs=3, num_threads=1)


@pytest.mark.parametrize("arguments", [{}, {"physics": "dm_control", "num_envs": 1}, {"moving_start": 1.0}])
def test_specs(arguments):
    check_env_specs(small(seed=0, **arguments), break_when_any_done="both")


def test_a_partial_reset_touches_only_its_rows():
    env = small(seed=0)
    td = env.rollout(4, break_when_any_done=False)[:, -1]["next"].exclude("reward")
    before = td.clone()
    td["_reset"] = torch.tensor([[False], [True], [False]])
    after = env.reset(td)
    for key in ("observation", "history", "command", "step_count", ("privileged", "intrinsic")):
        assert torch.equal(after[key][[0, 2]], before[key][[0, 2]]), key
    assert after["step_count"][1] == 0
    assert not torch.equal(after["privileged", "intrinsic"][1], before["privileged", "intrinsic"][1])
    assert torch.equal(after["history"][1], after["observation"][1].expand(10, -1))


def test_the_observation_holds_the_command_in_force():
    env = small(seed=0, window=5)
    ride = env.rollout(12, break_when_any_done=False)
    assert torch.equal(ride["observation"][..., -2:], ride["command"])
    assert torch.equal(ride["history"][:, 1:, -1], ride["observation"][:, :-1])
    changes = (ride["command"][:, 1:] != ride["command"][:, :-1]).any(-1)
    assert changes.all(0).nonzero().squeeze(-1).tolist() == [4, 9]


@pytest.mark.parametrize("seeds", [(0, 1), (None, None)])
def test_two_workers_draw_different_commands_and_intrinsics(seeds):
    env = SerialEnv(2, [partial(small, seed=seed) for seed in seeds])
    td = env.reset()
    for key in ("command", ("privileged", "intrinsic")):
        assert not torch.equal(td[key][0], td[key][1]), key
    env.close()


def test_forked_workers_without_a_seed_do_not_share_their_draws():
    env = ParallelEnv(2, small, mp_start_method="fork")
    td = env.reset()
    for key in ("command", ("privileged", "intrinsic")):
        assert not torch.equal(td[key][0], td[key][1]), key
    env.close()


def test_the_same_seed_gives_the_same_ride():
    rides = []
    for _ in range(2):
        torch.manual_seed(0)
        rides.append(small(seed=4).rollout(5))
    assert torch.equal(rides[0]["next", "observation"], rides[1]["next", "observation"])


def test_an_argument_that_nothing_has_is_named():
    with pytest.raises(TypeError, match=r"make_riding_env\(\) has no argument 'windows'; did you mean 'window'\?"):
        make_riding_env(num_envs=1, windows=3)
    env = make_riding_env(num_envs=1, score_from=3)  # one of the curriculum's
    assert env.curriculum.score_from == 3


def test_it_does_not_leave_the_cpu():
    env = make_riding_env(num_envs=1)
    with pytest.raises(ValueError, match="simulates on the CPU, not on cuda; give the collector env_device='cpu'"):
        env.to("cuda")  # needs none: it is refused before anything moves
    assert env.to("cpu") is env
    assert env.rollout(2)["action"].device.type == "cpu"

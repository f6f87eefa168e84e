"""The real env behind the standard transforms: TorchRL's own checks, partial resets, workers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
import torch
from torchrl.envs import ParallelEnv, SerialEnv
from torchrl.envs.utils import check_env_specs

from torchrl_atr._errors import InputError
from torchrl_atr.envs import make_env, make_riding_env, walking
from torchrl_atr.envs.tasks import CommandSpace

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


WALKING = walking("a1")


def without_speeds():
    return {key: group for key, group in WALKING.observations.items() if key != "speeds"}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"tracking_rewards": ("forward_comand", "turning_command")},
            "'forward_comand', which is not among its rewards",
        ),
        ({"tracking_rewards": ("forward_command", "slip")}, "'slip', which has no positive weight"),
        ({"tracking_rewards": ("forward_command",)}, "name one reward term for each of speed, yaw_rate"),
        ({"tracking_rewards": ()}, "name one reward term for each of speed, yaw_rate"),
        ({"command": replace(WALKING.command, grid=None)}, "has no grid to be drawn from"),
        ({"observations": without_speeds()}, "it observes no 'speeds', which overspeed_margin needs"),
    ],
)
def test_a_task_that_the_standard_transforms_do_not_fit_is_told_why(fields, message):
    with pytest.raises(InputError, match=f"task 'walking': .*{message}.*around a QuadrupedEnv"):
        make_env(WALKING.replace(**fields), 2, num_threads=1, overspeed_margin=(1.0, 1.0))


def test_a_command_of_three_components_needs_transforms_of_its_own():
    command = CommandSpace(("x", "y", "yaw"), ("m/s", "m/s", "rad/s"), WALKING.command.grid)
    rest = {name: term for name, term in WALKING.rewards.items() if name == "gait"}
    observations = {"proprio": WALKING.observations["proprio"]}
    task = WALKING.replace(command=command, rewards=rest, observations=observations, reward_schedule={})
    with pytest.raises(InputError, match="its command has 3 components, and a command curriculum draws two"):
        make_env(task, 2, num_threads=1)


@pytest.mark.parametrize("argument", [{"unscored_key": "x"}, {"tracking_max": (1.0, 1.0)}])
def test_what_follows_from_the_task_is_no_argument(argument):
    with pytest.raises(TypeError, match=r"sets .* of the curriculum itself, from the task; leave it out"):
        make_env(WALKING, 2, **argument)

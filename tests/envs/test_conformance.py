"""Every robot on every transporter, on both engines, held to one standard."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from torchrl_atr.envs import ROBOTS, RidingEnv
from torchrl_atr.envs.models import DESIGNS
from torchrl_atr.envs.tasks import RIDING_REWARDS, StepContext

PAIRS = [(robot, transporter) for robot in ROBOTS.names() for transporter in DESIGNS]
STEPS = 500


@pytest.fixture(params=PAIRS, ids="-".join)
def pair(request):
    return request.param


@pytest.fixture(params=["batch", "dm_control"])
def make(pair, request):
    """``make(seed)``: an env of the pair; one robot on dm_control, three on the batch engine."""
    physics = request.param

    def build(seed: int = 0) -> RidingEnv:
        num_envs = 1 if physics == "dm_control" else 3
        return RidingEnv(*pair, num_envs=num_envs, physics=physics, seed=seed, num_threads=1)

    return build


def ride(env: RidingEnv, steps: int) -> TensorDict:
    """A rollout under random actions; fallen robots go on."""
    generator = torch.Generator().manual_seed(1)
    td, steps_taken = env.reset(), []
    for _ in range(steps):
        td["action"] = torch.randn(env.action_spec.shape, generator=generator)
        td, following = env.step_and_maybe_reset(td)
        steps_taken.append(td["next"])
        td = following
    return torch.stack(steps_taken, 1)


def test_specs(make):
    check_env_specs(make())


def test_same_seed_same_ride(make):
    first, second = (ride(make(seed=3), 30) for _ in range(2))
    for key in ("observation", "reward", ("privileged", "extrinsic")):
        np.testing.assert_array_equal(first[key].numpy(), second[key].numpy())


def test_random_actions_stay_finite_move_every_observation_and_name_every_term(make):
    env = make()
    data = ride(env, STEPS)
    assert env.num_diverged == 0
    for key in ("observation", "reward", ("privileged", "intrinsic"), ("privileged", "extrinsic")):
        assert data[key].isfinite().all(), key
    for key in ("proprio", ("privileged", "extrinsic"), ("privileged", "outlook")):
        spread = data[key].flatten(0, 1).std(0)
        assert (spread > 0).all(), (key, (spread == 0).nonzero().squeeze(-1).tolist())
    assert set(data["reward_terms"].keys()) == set(RIDING_REWARDS)
    total = torch.stack([data["reward_terms", name] for name in RIDING_REWARDS]).sum(0)
    torch.testing.assert_close(total, data["reward"])


def test_every_episode_starts_standing_on_its_boards(make):
    """Table II in its training range, the robot upright and inside its deck."""
    env = make()
    size = torch.tensor(env.scene.support.spec.size[:2]) / 2
    for _ in range(3):
        td = env.reset()
        assert (td["privileged", "intrinsic"].abs() <= 1.0 + 1e-6).all()
        relative = td["privileged", "extrinsic"][:, 13:15].abs()
        assert (relative < size / 2).all()
        reading = env.runner.observe(torch.zeros(env.batch_size[0], 2))
        context = StepContext(env.runner.terms.reader.read(), *[td["command"]] * 3, None, env.scene, env.readings)
        assert not [name for name, ends in env.task.terminations.items() if ends(context).any()]
        assert (reading["proprio"][:, 6:8].abs() < 0.1).all()  # roll and pitch


@pytest.mark.parametrize("robot", ["a1", "go1"])
def test_a_standing_g1_robot_with_its_mass_centred_survives_on_the_single_board(robot):
    """Zero action, no pushes, Table II's training range with the trunk's CoM centred: 5 s, at least 80 % of draws."""
    env = RidingEnv(robot, "single_board", num_envs=128, pushes=False, seed=0)
    state = env.get_state()
    centred = state["x_int"].clone()
    centred[:, 1:4] = 0.0
    state["x_int"] = centred
    env.set_state(state)
    td = TensorDict({"action": torch.zeros(128, 12)}, [128])
    up = torch.ones(128, dtype=torch.bool)
    for _ in range(250):
        up &= ~env.step(td)["next", "terminated"].squeeze(-1)
    assert up.float().mean() >= 0.8

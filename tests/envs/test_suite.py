"""``suite.load``: an ordinary dm_control environment over the same task."""

from __future__ import annotations

import dm_env
import numpy as np
import pytest
import torch
from dm_control.rl import control
from torchrl.envs import DMControlWrapper
from torchrl.envs.utils import check_env_specs

from torchrl_atr.envs import QuadrupedEnv, suite
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks import ObservationTerm, riding, walking


@pytest.fixture(params=[riding, walking])
def task(request):
    """Every task of the package, without pushes."""
    return request.param(pushes=False)


def test_it_is_an_ordinary_dm_control_environment(task):
    environment = suite.load_task(task, random=0)
    assert isinstance(environment, control.Environment)
    first = environment.reset()
    assert first.first()
    assert environment.control_timestep() == pytest.approx(0.02)
    spec = environment.action_spec()
    spec.validate(np.zeros(spec.shape))
    for _ in range(3):
        step = environment.step(np.zeros(spec.shape))
        assert step.step_type == dm_env.StepType.MID
        assert np.isfinite(step.reward)
    for name, array_spec in environment.observation_spec().items():
        array_spec.validate(step.observation[name])


def test_observations_are_flat_and_none_is_called_state():
    observation = suite.load(random=0).reset().observation
    sizes = {name: value.shape for name, value in observation.items()}
    expected = {
        "proprio": 44,
        "command": 2,
        "moving_start": 1,
        "observation": 46,
        "speeds": 2,
        "dead_reckoned_velocity": 3,
        "privileged_intrinsic": 34,
        "privileged_extrinsic": 16,
        "privileged_tracking_forecast": 14,
    }
    assert sizes == {name: (size,) for name, size in expected.items()}


def test_walking_shows_its_clock_and_its_feet():
    observation = suite.load_task(walking(), random=0).reset().observation
    sizes = {name: value.shape[-1] for name, value in observation.items()}
    assert sizes == {
        "proprio": 46,
        "command": 2,
        "moving_start": 1,
        "observation": 48,
        "speeds": 2,
        "dead_reckoned_velocity": 3,
        "privileged_intrinsic": QuadrupedEnv(walking(), 1).runner.intrinsics.size,
        "privileged_extrinsic": 7,
        "privileged_tracking_forecast": 12,
    }


def test_torchrls_own_wrapper_takes_it(task):
    env = DMControlWrapper(suite.load_task(task, random=0))
    check_env_specs(env)
    size = env.observation_spec["observation"].shape[-1]
    assert env.rollout(3)["next", "observation"].shape == (3, size)


def test_action_bounds_are_those_of_riding_env():
    spec = suite.load(random=0).action_spec()
    env = RidingEnv(num_envs=1, seed=0, num_threads=1)
    np.testing.assert_array_equal(np.broadcast_to(spec.minimum, spec.shape), env.action_spec.space.low[0])
    np.testing.assert_array_equal(np.broadcast_to(spec.maximum, spec.shape), env.action_spec.space.high[0])


def test_it_is_the_task_that_the_env_asks(task):
    environment = suite.load_task(task, random=0)
    environment.task.command = (0.7, -0.2)
    first = environment.reset()
    env = QuadrupedEnv(task, num_envs=1, seed=3, num_threads=1)
    runner = environment.task.runner
    state = {**runner.get_state(), "command": torch.tensor([[0.7, -0.2]])}
    env.set_state(type(env.get_state())(state, batch_size=[1]))
    np.testing.assert_allclose(first.observation["observation"], env._emitted["observation"][0], atol=1e-6)
    rng = np.random.default_rng(0)
    for _ in range(30):
        action = 0.3 * rng.standard_normal(12).astype(np.float32)
        theirs = environment.step(action)
        td = env.fake_tensordict().set("action", torch.from_numpy(action)[None])
        ours = env.step(td.set("command", torch.tensor([[0.7, -0.2]])))["next"]
        for name, value in theirs.observation.items():
            key = tuple(name.split("_", 1)) if name.startswith("privileged") else name
            np.testing.assert_allclose(value, ours[key][0], atol=1e-5, err_msg=name)
        assert theirs.reward == pytest.approx(ours["reward"].item(), abs=1e-5)
        for name, value in environment.task.reward_terms.items():
            assert value == pytest.approx(ours["reward_terms", name].item(), abs=1e-5)
    assert set(environment.task.reward_terms) == set(task.rewards)
    np.testing.assert_allclose(runner.engine.qpos, env.engine.qpos, atol=1e-9)


def test_seeds_fix_the_episodes_and_episodes_differ(task):
    def intrinsics(seed: int) -> list[np.ndarray]:
        environment = suite.load_task(task, random=seed)
        return [environment.reset().observation["privileged_intrinsic"] for _ in range(2)]

    one, again, other = intrinsics(1), intrinsics(1), intrinsics(2)
    np.testing.assert_array_equal(one, again)
    assert (one[0] != one[1]).any()
    assert (one[0] != other[0]).any()


def test_a_fall_has_discount_zero_and_the_time_limit_one():
    environment = suite.load(random=0, time_limit=0.06)
    environment.reset()
    steps = [environment.step(np.zeros(12)) for _ in range(3)]
    assert [step.last() for step in steps] == [False, False, True]
    assert steps[-1].discount == 1.0
    assert environment.step(np.zeros(12)).first()
    environment.physics.data.qpos[environment.task.runner.scene.layout.root_qpos] += 1.0
    fallen = environment.step(np.zeros(12))
    assert fallen.last()
    assert fallen.discount == 0.0


@pytest.mark.parametrize("value", [1e13, np.nan])
def test_divergence_ends_the_episode_instead_of_the_program(task, value):
    environment = suite.load_task(task, random=0)
    for _ in range(2):
        environment.reset()
        environment.physics.data.qvel[8] = value
        step = environment.step(np.zeros(12))
        assert step.last()
        assert step.discount == 0.0
        assert step.reward == pytest.approx(environment.task.runner.terms.rewards.termination_cost)  # as QuadrupedEnv's
        assert all(np.isfinite(array).all() for array in step.observation.values())


def test_the_command_is_set_on_the_task():
    environment = suite.load(random=0)
    np.testing.assert_array_equal(environment.reset().observation["command"], [0.0, 0.0])
    environment.task.command = (1.0, 0.5)
    np.testing.assert_array_equal(environment.step(np.zeros(12)).observation["command"], [1.0, 0.5])
    np.testing.assert_array_equal(environment.reset().observation["command"], [1.0, 0.5])


@pytest.mark.parametrize("command", [(1.0,), (1.0, 2.0, 3.0), (np.nan, 0.0)])
def test_an_impossible_command_is_refused(command):
    with pytest.raises(ValueError, match="give 2 finite numbers"):
        suite.load(random=0).task.command = command


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="unknown robot 'dog'; known: a1"):
        suite.load("dog")
    with pytest.raises(ValueError, match="unknown randomization 'no'"):
        suite.load(randomization="no")
    environment = suite.load(random=0)
    environment.reset()
    with pytest.raises(ValueError, match="'action' is not finite"):
        environment.step(np.full(12, np.nan))
    with pytest.raises(ValueError, match=r"'action' has shape \(1, 11\)"):
        environment.step(np.zeros(11))


def test_a_walker_that_falls_has_discount_zero_and_its_clock_starts_anew():
    environment = suite.load_task(walking(pushes=False), random=0)
    environment.task.command = (1.0, 0.0)
    assert environment.reset().observation["proprio"][-2:].tolist() == [0.0, 1.0]
    clocks = [environment.step(np.zeros(12)).observation["proprio"][-2:] for _ in range(3)]
    np.testing.assert_allclose(np.arctan2(*np.stack(clocks).T), 2 * np.pi * 0.05 * np.arange(1, 4), atol=1e-5)  # 2.5 Hz
    environment.physics.data.qpos[environment.task.runner.scene.layout.root_qpos + 2] = 0.05
    fallen = environment.step(np.zeros(12))
    assert fallen.last()
    assert fallen.discount == 0.0
    assert environment.reset().observation["proprio"][-2:].tolist() == [0.0, 1.0]


def test_the_floor_moves_back_under_a_board_that_rides():
    environment = suite.load(random=0, pushes=False)
    environment.reset()
    engine = environment.task.runner.engine
    floor = environment.physics.model.name2id("floor", "geom")
    engine.hook.speeds[:] = torch.tensor([2.0, 0.0])
    engine.world_offset[:] = torch.tensor([1e4 + 0.3, 0.0], dtype=torch.float64)
    for _ in range(5):
        environment.step(np.zeros(12))
    moved = engine.world_offset[0] - torch.tensor([1e4, 0.0])
    assert moved[0] > 0.4
    np.testing.assert_allclose(environment.physics.data.geom_xpos[floor, :2], -moved, atol=1e-9)
    environment.reset()
    np.testing.assert_array_equal(environment.physics.data.geom_xpos[floor, :2], [0.0, 0.0])


def test_the_first_observation_has_the_errors_of_sensors_and_starts_may_move():
    one = ObservationTerm(lambda c: torch.ones(1, 1), bias=1.0)
    task = riding(pushes=False, moving_start=1.0).with_observation("proprio", one=one)
    environment = suite.load_task(task, random=0)
    environment.task.command = (1.0, 0.5)
    first = environment.reset().observation
    assert first["moving_start"].all()
    assert first["proprio"][-1] != 1.0
    assert environment.step(np.zeros(12)).observation["proprio"][-1] == first["proprio"][-1]

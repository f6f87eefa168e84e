"""Parameters of a running env: in force from each robot's next episode, refused as a whole."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import SerialEnv

from torchrl_atr._errors import InputError
from torchrl_atr.envs import make_env, make_riding_env, reconfigure, walking
from torchrl_atr.envs.tasks.events import Disturbance, Pushes

ROBOTS = 6


@pytest.fixture
def env():
    return make_riding_env(num_envs=ROBOTS, num_threads=1, seed=0, max_steps=10_000, window=5)


def reset(env, rows):
    """Begin episodes of some robots."""
    mask = torch.zeros(ROBOTS, 1, dtype=torch.bool)
    mask[rows] = True
    data = env.rand_action(env.fake_tensordict().exclude("next")).set("_reset", mask)
    return env.reset(data)


def stand(env, steps):
    """Steps with actions of zero, from where the env is."""
    policy = lambda tensordict: tensordict.set("action", torch.zeros(ROBOTS, 12))  # noqa: E731
    return env.rollout(steps, policy, auto_reset=False, tensordict=env.reset(), break_when_any_done=False)


def test_randomisation_changes_with_the_next_episode(env):
    before = env.reset()["privileged", "intrinsic"].clone()
    env.reconfigure(randomization={"payload": (0.4, 0.4), "friction": (0.5, 0.6)})
    reset(env, [1, 4])
    after = env.runner.x_int
    others = [0, 2, 3, 5]
    torch.testing.assert_close(after[others], before[others], rtol=0, atol=0)
    intrinsics = env.runner.intrinsics
    values = intrinsics.values(after[[1, 4]])
    torch.testing.assert_close(values["payload"], torch.full((2, 1), 0.4, dtype=torch.float64), atol=1e-6, rtol=0)
    assert bool(((values["friction"] >= 0.5) & (values["friction"] <= 0.6)).all())
    env.reconfigure(randomization="off")
    nominal = env.reset()["privileged", "intrinsic"]
    torch.testing.assert_close(nominal, intrinsics.sample(ROBOTS, "off", torch.Generator()))


def test_a_single_component_can_be_chosen(env):
    env.reconfigure(randomization={"com_shift[1]": (0.3, 0.3)})
    env.reset()
    shift = env.runner.intrinsics.values(env.runner.x_int)["com_shift"]
    assert shift[:, 1].tolist() == pytest.approx([0.3] * ROBOTS)
    assert shift[:, [0, 2]].abs().max() <= 0.2
    for name in ("com_shift[3]", "com_shift[x]"):
        with pytest.raises(ValueError, match=r"is no component of 'com_shift'; give com_shift\[0\] to com_shift\[2\]"):
            env.reconfigure(randomization={name: (0.0, 0.0)})


def test_a_longer_delay_changes_with_the_next_episode(env):
    env.reset()
    env.reconfigure(sensors={"joint_position": {"delay": 3.0}})
    env.reset()
    stand(env, 4)
    held = env.runner.sensor_errors.state["before of proprio"]
    assert held.shape[-1] == 3 * env.observation_spec["proprio"].shape[-1]
    env.reconfigure(sensors="realistic")
    env.reset()
    stand(env, 2)


def test_sensor_errors_change_with_the_next_episode(env):
    env.reset()
    env.reconfigure(sensors={"orientation": {"noise": 0.1, "bias": 1.0, "bias_time": 10.0}})
    errors, rows = env.runner.sensor_errors, torch.tensor([1, 4])
    reset(env, rows)
    columns = env.runner.terms.observations.sizes["proprio"]
    first = list(columns).index("orientation")
    begin = sum(list(columns.values())[:first])
    steps = torch.stack([errors.step()["proprio"]["offset"] for _ in range(400)])
    assert bool((steps[:, [0, 2, 3, 5]] == 0).all())
    assert bool((steps[:, rows, :begin] == 0).all())
    noise = steps[1:, rows, begin : begin + 2] - steps[:-1, rows, begin : begin + 2]  # of two steps, and of the bias
    wandered = 2.0 * (1.0 - torch.exp(torch.tensor(-0.02 / 10.0)))
    assert float(noise.var()) == pytest.approx(2 * 0.1**2 + float(wandered), rel=0.15)
    env.reconfigure(sensors="ideal")
    reset(env, [1])
    steps = torch.stack([errors.step()["proprio"]["offset"] for _ in range(3)])
    assert bool((steps[:, 1] == 0).all())
    assert bool((steps[:, 4].abs().sum(-1) > 0).all())  # its episode goes on


def test_realistic_sensors_that_come_later_are_those_from_the_beginning(env):
    env.reconfigure(sensors="realistic", randomization="off", pushes=False)
    arguments = {"sensors": "realistic", "randomization": "off", "pushes": False}
    other = make_riding_env(num_envs=ROBOTS, num_threads=1, seed=1, max_steps=10_000, window=5, **arguments)
    for each in (env, other):
        each.set_seed(7)
    torch.testing.assert_close(stand(env, 8)["proprio"], stand(other, 8)["proprio"], rtol=0, atol=0)


def test_pushes_change_with_the_next_episode(env):
    pushed = []

    def note(engine, rows, generator, pushes):
        pushed.append((pushes.robot, rows.tolist()))

    task = env.base_env.task
    disturbance = type(task.disturbances["push"])(partial(note, pushes=Pushes(interval=0.04)), 0.04, is_push=True)
    env = make_env(task.replace(disturbances={"push": disturbance}), ROBOTS, num_threads=1, seed=0)
    env.reset()
    env.reconfigure(pushes=Pushes(interval=0.02, robot=2.0))
    reset(env, [1, 4])
    for _ in range(3):
        env.runner.apply_action(torch.zeros(ROBOTS, 12))
        env.engine.advance(1)
        env.runner.evaluate_step(torch.zeros(ROBOTS, 2))
    assert pushed == [(2.0, [1, 4]), (0.5, [0, 2, 3, 5]), (2.0, [1, 4])]
    env.reconfigure(pushes=False)
    env.reset()
    pushed.clear()
    for _ in range(3):
        env.runner.apply_action(torch.zeros(ROBOTS, 12))
        env.runner.evaluate_step(torch.zeros(ROBOTS, 2))
    assert not pushed


def test_commands_stay_within_bounds_and_the_curriculum_goes_on(env):
    curriculum = env.curriculum
    curriculum.load_weights(torch.ones(curriculum.grid.shape))
    env.reconfigure(command_bounds=(1.0, 0.4))
    drawn = stand(env, 60)["command"].reshape(-1, 2)
    assert bool((drawn.abs() <= torch.tensor([1.0, 0.4])).all())
    assert float(drawn[:, 0].abs().max()) > 0.8
    cells = curriculum.grid.cell_of(curriculum.rows.command)
    torch.testing.assert_close(curriculum.rows.cells, cells)  # of the whole grid, whose weights grow
    assert curriculum.frontier == curriculum.grid.bounds
    env.reconfigure(command_bounds=curriculum.grid.bounds)
    assert float(stand(env, 60)["command"][..., 0].abs().max()) > 2.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sensor": "ideal"}, "no parameter 'sensor' to change; did you mean 'sensors'?"),
        ({"sensors": "perfect"}, "unknown sensor set 'perfect'"),
        ({"sensors": {"gyro": {"noise": 0.1}}}, "the sensor set names 'gyro'; the observation terms are acceleration"),
        ({"sensors": {"orientation": {"noise": -0.1}}}, "sensors: noise=-0.1: choose a number 0 or more"),
        ({"sensors": {"orientation": {"nois": 0.1}}}, "'orientation' the errors .* give a mapping with noise, bias"),
        ({"randomization": "tests"}, "unknown randomization 'tests'; choose one of train, test, off"),
        ({"randomization": {"mass": (0, 1)}}, "randomization: there is no intrinsic parameter 'mass'"),
        ({"randomization": {"payload": (1, 0)}}, r"randomization: payload=\(1, 0\) is no range"),
        ({"pushes": "hard"}, "pushes='hard': choose True or False"),
        ({"command_bounds": (20.0, 1.0)}, r"command_bounds: bounds=\(20.0, 1.0\) exceed those of the grid"),
        ({"command_bounds": (1.1, 1.0)}, "command_bounds: .* must be a whole multiple of its bin 0.2"),
        ({"command_bounds": 1.0}, "command_bounds: bounds must be two positive numbers"),
    ],
)
def test_what_does_not_fit_is_named_and_changes_nothing(env, changes, message):
    ends = env.runner.ends.clone()
    with pytest.raises(ValueError, match=message):
        env.reconfigure(**{"randomization": "off", "command_bounds": (1.0, 1.0)} | changes)
    torch.testing.assert_close(env.runner.ends, ends)
    assert env.curriculum.limits.part.bounds == env.curriculum.grid.bounds


def test_a_disturbance_that_is_not_marked_as_a_push_is_named():
    """Else robots would be pushed on by a task's own function after pushes=False."""
    shove = Disturbance(lambda engine, rows, generator: None, 1.0)
    env = make_env(walking().replace(disturbances={"shove": shove}), num_envs=2, num_threads=1)
    with pytest.raises(InputError, match="none of the disturbances of task 'walking' is a push: shove; give the one"):
        env.reconfigure(pushes=False)


def test_pushes_that_were_never_made_cannot_be_changed():
    env = make_env(walking(pushes=False), num_envs=2, num_threads=1)
    env.reconfigure(pushes=False)
    with pytest.raises(
        ValueError, match="pushes: the env of task 'walking' was made without any; make it with pushes=True"
    ):
        env.reconfigure(pushes=True)


def test_collectors_and_batched_envs_of_this_process_pass_changes_on():
    make = partial(make_riding_env, num_envs=2, num_threads=1, seed=0, max_steps=2)
    env = SerialEnv(2, make)
    env.reset()
    collector = Collector(env, None, frames_per_batch=4 * 2, total_frames=64)
    batches = iter(collector)
    next(batches)
    reconfigure(collector, randomization="off")
    next(batches)
    batch = next(batches)["privileged", "intrinsic"].flatten(0, 2)
    torch.testing.assert_close(batch, batch[:1].expand_as(batch))
    with pytest.raises(ValueError, match="no parameter 'windows' to change"):
        reconfigure(collector, windows=3)
    collector.shutdown()


def test_envs_that_cannot_be_changed_are_named():
    from torchrl.testing.mocking_classes import ContinuousActionVecMockEnv

    with pytest.raises(ValueError, match="the envs of this ContinuousActionVecMockEnv cannot be changed"):
        reconfigure(ContinuousActionVecMockEnv(), sensors="ideal")

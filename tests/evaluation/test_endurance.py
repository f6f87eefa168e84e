"""Endurance on the puppet, whose speeds are its actions: 0.1 s a step, a command a second."""

from functools import partial

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import Compose, TransformedEnv

from torchrl_atr.envs import make_env
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks import riding, walking
from torchrl_atr.envs.tasks.events import Disturbance
from torchrl_atr.envs.transforms import CommandCurriculum, CommandGrid, task_transforms
from torchrl_atr.evaluation import endurance_log, evaluate_endurance
from torchrl_atr.evaluation import ride as ride_module
from torchrl_atr.evaluation.access import ended_by
from torchrl_atr.modules import make_networks

from .conftest import PuppetEnv, puppet_env


def still(observation):
    return observation.new_zeros(len(observation), 12)


STILL = TensorDictModule(still, in_keys=["observation"], out_keys=["action"])


class Delayed:
    """Follows the command of ``delay`` steps ago, zero before the first."""

    def __init__(self, delay):
        self.delay, self.seen = delay, []

    def __call__(self, command):
        self.seen.append(command.clone())
        old = len(self.seen) - 1 - self.delay
        return self.seen[old] if old >= 0 else torch.zeros_like(command)


def falls_at(steps, speeds=None):
    """Perfect tracking; robot i falls in step ``steps[i]`` (None: never)."""
    count = iter(range(10**6))

    def act(command):
        step, action = next(count), command.clone()
        for row, last in enumerate(steps):
            if step == last:
                action[row] = torch.nan if speeds is None else torch.tensor(speeds)
        return action

    return act


def test_every_command_lasts_its_seconds_and_is_what_the_policy_sees(endure):
    policy = Delayed(0)
    result = endure(policy, robots=3, seconds=2.5)
    assert result.commands.shape == (3, 3, 2)
    seen = torch.stack(policy.seen).double().numpy()
    np.testing.assert_array_equal(seen, result.commands[[0] * 10 + [1] * 10 + [2] * 5])
    assert (np.abs(result.commands) <= [2.0, 1.0]).all()
    assert len(np.unique(result.commands)) == result.commands.size
    assert result.survived.all()


def test_the_seed_decides_the_commands(endure):
    first, again, other = (endure(Delayed(0), seed=seed).commands for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()


def test_commands_fill_their_bounds(endure):
    commands = endure(Delayed(0), robots=500, max_speed=3.0, max_yaw_rate=0.0).commands
    assert -3.0 <= commands[..., 0].min() < -2.9
    assert 2.9 < commands[..., 0].max() <= 3.0
    assert (commands[..., 1] == 0).all()


def test_what_is_late_by_less_than_the_settling_time_has_no_error(endure):
    result = endure(Delayed(3), seconds=3.0, settle=0.3)
    np.testing.assert_allclose(result.settled_error, 0.0, atol=1e-6)
    assert (result.settled_steps == 7).all()


def test_errors_of_a_late_ride_by_hand(endure):
    """Three steps late, two of them left out: one step of eight is off by the change of the command."""
    result = endure(Delayed(3), seconds=3.0, settle=0.2)
    before = np.concatenate([np.zeros((1, 4, 2)), result.commands[:-1]])
    np.testing.assert_allclose(result.settled_error, np.abs(result.commands - before) / 8, atol=1e-6)


def test_falls_are_dated_and_end_the_figures(endure):
    result = endure(falls_at([0, 12, 29, None]), seconds=3.0)
    np.testing.assert_allclose(result.fall_time, [0.1, 1.3, 3.0, np.nan])
    np.testing.assert_allclose(result.since_command, [0.1, 0.3, 1.0, np.nan])
    assert result.fall_cause.tolist() == ["terminated", "terminated", "terminated", ""]
    assert result.up_steps.T.tolist() == [[1, 0, 0], [10, 3, 0], [10, 10, 10], [10, 10, 10]]
    assert np.isnan(result.since_push).all()
    assert np.isnan(result.push_seconds)


def test_a_ride_beyond_any_command_counts_as_a_fall(endure):
    act = partial(falls_at, [None, 4, None, None])
    for speeds in ([4.5, 0.0], [-4.5, 0.0], [0.0, 3.5]):
        result = endure(act(speeds))
        assert result.fall_cause.tolist() == ["", "overspeed", "", ""]
        assert result.fall_time[1] == pytest.approx(0.5)
    assert endure(act([3.9, 2.9])).survived.all()
    assert endure(act([9.0, 9.0]), overspeed=None).survived.all()


def test_what_is_too_fast_goes_by_the_largest_command_also_where_none_goes_backwards(endure):
    """Commands from 0 to 1.5 m/s with a margin of 2 m/s: a fall is beyond 3.5 m/s."""

    def forward_env(num_envs, seed):
        commands = CommandCurriculum((1.0, 1.0), grid=CommandGrid(forward_only=True), seed=seed)
        return TransformedEnv(PuppetEnv(num_envs, seed), Compose(commands))

    for speed, causes in ((3.4, [""] * 2), (3.6, ["", "overspeed"])):
        result = endure(falls_at([None, 4], [speed, 0.0]), robots=2, make_env=forward_env, max_speed=1.5)
        assert result.bounds[:, 0].tolist() == [0.0, 1.5]
        assert result.fall_cause.tolist() == causes


def test_pushes_are_dated(endure, monkeypatch):
    """Every 7 steps, at the start of steps 7, 14, ...: a fall in step 6 knows none, one in step 7 came 0.1 s after."""
    monkeypatch.setattr(endurance_log, "disturbance_steps", lambda env: {"push": 7})
    result = endure(falls_at([6, 7, 13, 20]), seconds=3.0)
    np.testing.assert_allclose(result.since_push, [np.nan, 0.1, 0.7, 0.7])
    assert result.push_seconds == pytest.approx(0.7)


def test_an_env_pushes_when_the_log_says_so():
    decided, pushed = [], []

    def decide(observation):
        decided.append(len(decided))
        return still(observation)

    task = riding().replace(disturbances={"note": Disturbance(lambda *_: pushed.append(decided[-1]), 0.1)})
    policy = TensorDictModule(decide, in_keys=["observation"], out_keys=["action"])
    result = evaluate_endurance(policy, partial(make_env, task, num_threads=1), 1, 0.34, 0.2, 0.0)
    assert result.push_seconds == pytest.approx(0.1)
    assert pushed == [5, 10, 15]


def test_chunks_change_nothing_and_have_their_own_seeds(endure, monkeypatch):
    seeds = []

    def make(num_envs, seed):
        seeds.append((num_envs, seed))
        return puppet_env(num_envs, seed)

    whole = endure(lambda command: 0.5 * command, robots=7, make_env=make, seed=3)
    monkeypatch.setattr(ride_module, "MAX_ROBOTS", 3)
    done = []
    parts = endure(
        lambda command: 0.5 * command, robots=7, make_env=make, seed=3, progress=lambda *step: done.append(step)
    )
    assert [each for each in seeds if each[0] > 1 or each[1] > 0] == [(7, 3), (3, 3), (3, 4), (1, 5)]
    np.testing.assert_array_equal(whole.settled_error, parts.settled_error)
    np.testing.assert_array_equal(whole.intrinsics, parts.intrinsics)
    assert done == [(step, 60) for step in range(1, 61)]


def test_estimate_errors_second_by_second(endure):
    """The estimate misses by 1, 2, 3, 4 times the number of the second."""
    count = iter(range(20))

    def decide(command):
        off = (next(count) // 10 + 1) * torch.arange(1.0, 5.0)
        return command, (torch.arange(4.0) + off).expand(len(command), 4)

    policy = TensorDictModule(decide, in_keys=["command"], out_keys=["action", ("estimate", "extrinsic")])
    result = endure(policy)
    np.testing.assert_allclose(result.estimate_error[0, 0], [1, 2, 3, 4], rtol=1e-6)
    np.testing.assert_allclose(result.estimate_error[1, 3], [2, 4, 6, 8], rtol=1e-6)
    assert result.latent_error is None
    assert endure(lambda command: command).estimate_error is None


def _riding(num_envs, seed):
    return TransformedEnv(
        RidingEnv(num_envs=num_envs, seed=seed, num_threads=1), task_transforms((0.16, 0.16), seed=seed)
    )


def test_the_deployed_policy_on_the_real_env():
    env = _riding(1, 0)
    networks = make_networks(env.observation_spec, env.action_spec, estimator="mlp")
    run = partial(evaluate_endurance, networks.deployed_policy(), _riding, 2, 1.4, 0.5, 0.2, 1.0, 0.5)
    result, again = run(encoder_module=networks.encoder_module), run()
    assert np.isfinite(result.settled_error[0]).all()
    np.testing.assert_array_equal(result.settled_error, again.settled_error)
    assert result.components[0] == ("contacts[0]", "contact FR", "1")
    assert result.estimate_error.shape == (2, 2, 16)
    assert np.isfinite(result.latent_error[0]).all()
    assert result.push_seconds == 3.0
    assert result.intrinsics.shape == (2, len(result.intrinsic_names))
    assert (result.intrinsics[0] != result.intrinsics[1]).any()
    assert "privileged.intrinsic" not in result.policy_reads


def test_walkers_are_asked_for_what_they_can_do():
    make = partial(make_env, walking(), num_threads=1)
    result = evaluate_endurance(STILL, make, 50, 0.1, 0.02, 0.0)
    assert result.bounds.tolist() == [[0.0, -1.0], [1.5, 1.0]]
    assert (result.commands[..., 0] >= 0).all()


def test_why_each_robot_went_down():
    """One rolled over, one beyond the board, one that fails, one that stands."""
    env = RidingEnv(num_envs=4, seed=0, num_threads=1, randomization="off")
    env.reset()
    assert not any(rows.any() for rows in ended_by(env).values())
    root = env.scene.layout.root_qpos
    env.engine.qpos[0, root + 3 : root + 7] = torch.tensor([np.cos(0.7), np.sin(0.7), 0, 0], dtype=torch.float64)
    env.engine.qpos[0, root + 2] += 0.3
    env.engine.qpos[1, root : root + 3] += torch.tensor([1.5, 0.0, 0.5], dtype=torch.float64)
    env.engine.qvel[2] = 1e9
    env.step(env.full_action_spec.zero())
    causes = {name: rows.tolist() for name, rows in ended_by(env).items()}
    assert list(causes) == ["diverged", "tilted", "off_the_boards", "too_low"]
    assert causes["tilted"][0]
    assert causes["off_the_boards"][1]
    assert causes["diverged"] == [False, False, True, False]
    assert not any(rows[3] for rows in causes.values())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seconds": 0.0}, "seconds=0.0 must be at least a control step"),
        ({"seconds": float("inf")}, "seconds=inf"),
        ({"settle": 1.0}, "settle=1.0 shorter than command_seconds=1.0"),
        ({"robots": 0}, "robots=0"),
        ({"max_speed": -1.0}, "max_speed=-1.0"),
        ({"max_speed": 15.1}, "max_speed=15.1 is beyond the largest command that the env takes; give up to 15"),
        ({"max_yaw_rate": "fast"}, "max_yaw_rate='fast'"),
        ({"overspeed": (0.0, 1.0)}, "overspeed"),
        ({"seed": -1}, "seed=-1"),
    ],
)
def test_bad_input_is_named(endure, options, message):
    with pytest.raises(ValueError, match=message):
        endure(lambda command: command, **options)

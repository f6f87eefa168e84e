"""Trips on the simulated robots: outcomes, energy, files."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest
import shapely
import torch
from tensordict.nn import TensorDictModule

from torchrl_atr._errors import InputError
from torchrl_atr.envs import make_env, make_riding_env
from torchrl_atr.envs.tasks import walking
from torchrl_atr.evaluation.energy import robot_mass
from torchrl_atr.modules import CommandRange
from torchrl_atr.navigation import Map, Path, PursuitConfig, load_map, measure_power, run_trips
from torchrl_atr.navigation.report import trip_metrics, write_trips
from torchrl_atr.navigation.trips import check_commands, footprint_of, poses_of

FIELD = Map("field", shapely.box(-10, -10, 10, 10))
MAKE = partial(make_riding_env, "a1", "two_board", num_threads=1, pushes=False, randomization="off")
STAND = TensorDictModule(lambda observation: torch.zeros(len(observation), 12), ["observation"], ["action"])
NEAR = Path.through(np.linspace([0.0, 0.0], [1.5, 0.0], 4))
NORTH = Path.through(np.linspace([0.0, 0.0], [0.0, 1.5], 4))


def trips(paths, where=FIELD, **config):
    return run_trips(STAND, MAKE, paths, where, PursuitConfig(**{"speed": 3.0, "goal_radius": 0.5, **config}))


def test_a_robot_that_stands_times_out_where_it_started():
    result = trips([NEAR, NORTH])
    assert result.outcome.tolist() == ["timeout", "timeout"]
    np.testing.assert_allclose(result.seconds, 2 * 1.5 / 3.0)
    assert result.travelled.max() < 0.3
    np.testing.assert_allclose([trace[0, 2] for trace in result.traces], [0.0, np.pi / 2], atol=1e-6)
    trace, seconds = result.traces[0], result.seconds[0]
    np.testing.assert_allclose(trace[:, 3], [0.0, *np.arange(0.2, seconds - 1e-9, 0.2), seconds])
    between = np.diff(trace[:, 3])
    np.testing.assert_allclose((between * trace[1:, 4]).sum() / seconds, result.joint_power[0])
    np.testing.assert_allclose((between * trace[1:, 5]).sum() / seconds, result.drive_power[0])
    assert result.spl.tolist() == [0.0, 0.0]


def test_a_trip_ends_at_the_goal_or_at_an_obstacle():
    tiny = Map("tiny", shapely.box(-10, -10, 10, 10), (shapely.box(0.2, -1, 0.3, 1),))
    assert trips([NEAR], tiny).outcome.tolist() == ["collided"]
    reached = trips([NEAR], goal_radius=2.0)
    assert reached.outcome.tolist() == ["goal"]
    assert reached.seconds[0] == pytest.approx(0.02)
    assert reached.spl[0] == 1.0


def test_a_speed_that_the_env_does_not_take_is_refused_before_the_simulation():
    with pytest.raises(InputError, match="speed=50 is beyond the env's largest command, 15"):
        trips([NEAR], speed=50.0)


def test_a_command_that_the_policy_would_clip_is_refused():
    env, limits = MAKE(num_envs=1, seed=0), CommandRange(max_speed=1.0, max_yaw_rate=0.5)
    check_commands(env, PursuitConfig(speed=1.0, max_yaw_rate=0.5), limits)
    with pytest.raises(InputError, match=r"max_yaw_rate=0\.6 is beyond the policy's largest command, 0\.5"):
        check_commands(env, PursuitConfig(speed=1.0, max_yaw_rate=0.6), limits)


def test_the_drive_pays_for_resistance_at_a_steady_speed():
    env = MAKE(num_envs=1, seed=0)
    env.reset()
    engine = env.base_env.engine
    hook = engine.hook
    hook.speeds.copy_(torch.tensor([[2.0, 0.0]], dtype=torch.float64))
    c0, c1, c2 = hook.law.transporter.resistance
    boards, resisted = hook.law.transporter.mass, c0 + 2 * c1 + 4 * c2
    tilts = engine.qpos[:, hook._tilt]
    drive = hook.law.transporter.max_acceleration / hook.law.transporter.tilt_norm  # per rad
    engine.qpos[:, hook._tilt] = torch.full_like(tilts, resisted / drive)  # holds the speed: m R(v) v
    assert hook.power().item() == pytest.approx(boards * resisted * 2.0, rel=0.02)
    engine.qpos[:, hook._tilt] = torch.full_like(tilts, (resisted + 1.0) / drive)  # 1 m/s² for all that moves
    all_of_it = engine.fields["body_mass"].sum().item()
    assert hook.power().item() == pytest.approx(boards * resisted * 2.0 + all_of_it * 2.0, rel=0.02)


def test_power_and_mass_are_of_the_robot_alone():
    env = MAKE(num_envs=2, seed=0)
    env.rollout(3)
    power = measure_power(env)
    assert power.joints.shape == (2, 12)
    assert (power.joints >= 0).all()
    assert robot_mass(env)[0].item() == pytest.approx(12.5, abs=1.5)


def test_a_walking_robot_has_a_pose_and_a_footprint_too():
    env = make_env(walking("a1"), num_envs=1, seed=0, num_threads=1)
    env.reset()
    np.testing.assert_allclose(poses_of(env), [[0.0, 0.0, 0.0]], atol=0.05)
    length, width = footprint_of(env)
    assert 0.6 > length > width > 0.2


def test_metrics_and_files_say_what_happened(tmp_path):
    result = trips([NEAR, NORTH], goal_radius=2.0)
    metrics = trip_metrics(result)
    assert metrics["outcomes"] == {"goal": 2, "fell": 0, "collided": 0, "timeout": 0}
    assert metrics["success"] == 1.0
    assert metrics["spl"]["mean"] == 1.0
    files = write_trips(result, [NEAR, NORTH], FIELD, metrics, tmp_path)
    assert json.loads(files["metrics.json"].read_text())["success_interval"][0] < 0.5
    assert all(files[name].stat().st_size > 1000 for name in ("overview.png", "trip.gif"))
    with np.load(files["trips.npz"]) as arrays:
        np.testing.assert_array_equal(arrays["path_0"], NEAR.points)


def test_without_a_success_there_is_no_cost_of_transport():
    assert trip_metrics(trips([NEAR]))["cot_paper"] == {"mean": None, "interval": None}


def test_the_maps_of_the_package_have_room_for_trips():
    from torchrl_atr.navigation.places import draw_places

    for name in ("open", "streets"):
        starts, goal = draw_places(load_map(name), 50, (0.8, 0.4), 0.8)
        assert len(starts) == 50
        assert load_map(name).holds([*starts, goal]).all()

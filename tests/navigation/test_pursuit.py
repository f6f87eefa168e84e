"""Pure pursuit on a robot that obeys its commands at once."""

from __future__ import annotations

import numpy as np
import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.navigation import Path, PurePursuit, PursuitConfig

DT = 0.02


def circle(radius: float) -> Path:
    angle = np.linspace(0.0, 1.5 * np.pi, 200)
    return Path.through(radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)], -1))


STRAIGHT = Path.through(np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [30.0, 0.0]]))


def follow(paths, poses, config, seconds):
    pursuit, poses = PurePursuit(paths, config), np.array(poses, dtype=float)
    away, commands = [], []
    for _ in range(round(seconds / DT)):
        command = pursuit.command(poses)
        speed, rate = command.T
        poses = poses + DT * np.stack([speed * np.cos(poses[:, 2]), speed * np.sin(poses[:, 2]), rate], -1)
        away.append(pursuit.locate(poses))
        commands.append(command)
    return pursuit, poses, np.array(away), np.array(commands)


def test_it_follows_a_straight_line_and_a_circle_at_their_curvature():
    config = PursuitConfig(speed=1.0)
    pursuit, poses, away, commands = follow([STRAIGHT, circle(5.0)], np.zeros((2, 3)), config, 15.0)
    assert away.max() < 0.05
    assert commands[100:600, 1, 1].mean() == pytest.approx(0.2, rel=0.03)  # v / r
    assert np.abs(commands[:, 0, 1]).max() < 1e-6
    assert not pursuit.reached(poses).any()


def test_a_robot_beside_the_path_returns_to_it():
    _, poses, away, _ = follow([STRAIGHT], [(0.0, 2.0, 0.5)], PursuitConfig(speed=1.0, max_yaw_rate=2.0), 12.0)
    assert away[0] > 1.9
    assert away[-1] < 0.05
    assert abs(poses[0, 2]) < 0.05


def lateral_errors(response, lag=1.8, seconds=40.0):
    """Return distances to a line from 1 m beside it, of a robot whose yaw rate follows commands with a lag, s."""
    line = Path.through(np.array([[0.0, 0.0], [30.0, 0.0], [60.0, 0.0], [90.0, 0.0]]))
    pursuit = PurePursuit([line], PursuitConfig(speed=1.5, response=response))
    (x, y, yaw), rate, away = (0.0, 1.0, 0.0), 0.0, []
    for _ in range(round(seconds / DT)):
        speed, asked = pursuit.command(np.array([[x, y, yaw]]))[0]
        rate += DT / lag * (asked - rate)
        yaw += DT * rate
        x, y = x + DT * speed * np.cos(yaw), y + DT * speed * np.sin(yaw)
        away.append(abs(y))
    return np.array(away)


def test_a_robot_that_turns_late_weaves_unless_its_response_is_known():
    assert lateral_errors(response=0.0)[-500:].max() > 0.5  # the look-ahead of 1 s is shorter than the lag
    assert lateral_errors(response=1.8)[-500:].max() < 0.02


def test_the_prediction_follows_the_arc_that_is_driven():
    pursuit = PurePursuit([circle(5.0)], PursuitConfig(speed=1.0, response=2.0))
    angle = 0.2 * DT * np.arange(100)
    for pose in np.stack([5.0 * np.sin(angle), 5.0 * (1.0 - np.cos(angle)), angle], -1):
        later = pursuit._predicted(pose[None])[0]
    ahead = angle[-1] + 0.2 * 2.0
    np.testing.assert_allclose(later, [5.0 * np.sin(ahead), 5.0 * (1.0 - np.cos(ahead)), ahead], atol=0.02)


def test_it_brakes_before_the_goal_and_stops_there():
    config = PursuitConfig(speed=2.0, deceleration=0.5, goal_radius=0.5)
    pursuit, poses, _, commands = follow([STRAIGHT], np.zeros((1, 3)), config, 25.0)
    assert pursuit.reached(poses).all()
    speed = commands[:, 0, 0]
    assert speed[:400].max() == pytest.approx(2.0)
    assert speed[-1] < 0.4
    assert (speed[:-1] ** 2 - speed[1:] ** 2).max() < 2 * 0.5 * 0.1 + 1e-6  # v² falls by 2 a for each point passed


def test_speed_falls_where_a_turn_would_exceed_the_yaw_rate():
    _, _, _, commands = follow([circle(2.0)], np.zeros((1, 3)), PursuitConfig(speed=3.0, max_yaw_rate=0.5), 4.0)
    assert np.abs(commands[..., 1]).max() <= 0.5
    assert commands[-1, 0, 0] < 2.0


def test_a_path_that_crosses_itself_is_followed_in_order():
    angle = np.linspace(0.0, 2 * np.pi, 400)
    eight = Path.through(np.stack([8 * np.sin(angle), 4 * np.sin(2 * angle)], -1))
    start = [(0.0, 0.0, eight.headings[0])]
    pursuit, _, away, _ = follow([eight], start, PursuitConfig(speed=1.0), eight.length / 2 + 3.0)
    assert away.max() < 0.15
    assert pursuit.progress[0] > len(eight.points) / 2


def test_the_arc_to_a_goal_that_is_near_is_no_tighter_than_that_to_the_least_distance():
    """0.1 m before the goal and 0.1 m beside the path: κ = 2 y / L² with L = 1 m, at √(2 a 0.1 m)."""
    short = Path.through(np.linspace([0.0, 0.0], [1.5, 0.0], 4))
    config = PursuitConfig(min_look_ahead=1.0, deceleration=0.5)
    ((speed, rate),) = PurePursuit([short], config).command(np.array([[1.4, 0.1, 0.0]]))
    assert speed == pytest.approx(np.sqrt(0.1), rel=0.02)
    assert rate == pytest.approx(-0.2 * speed, rel=0.02)


def test_a_yaw_that_is_given_within_half_a_turn_is_the_same_yaw():
    west = Path.through(np.linspace([0.0, 0.0], [-5.0, 0.0], 4))
    whole, wrapped = (PurePursuit([west], PursuitConfig(response=2.0)) for _ in range(2))
    for yaw in np.pi + 0.01 * np.arange(-4.5, 5.0):
        pose = np.array([[0.0, 0.1, yaw]])
        within = pose - [0.0, 0.0, 2.0 * np.pi * (yaw > np.pi)]
        np.testing.assert_allclose(wrapped.command(within), whole.command(pose), atol=1e-9)


def test_it_brakes_by_where_it_is_not_by_where_it_will_be():
    """3 m before the goal at 1 m/s, with a response of 2 s: √(2 a 3 m)."""
    path = Path.through(np.linspace([0.0, 0.0], [4.0, 0.0], 4))
    pursuit = PurePursuit([path], PursuitConfig(speed=1.0, response=2.0, deceleration=0.1))
    for x in np.linspace(0.0, 1.0, 51):  # 0.02 m in each step
        ((speed, _),) = pursuit.command(np.array([[x, 0.0, 0.0]]))
    assert speed == pytest.approx(np.sqrt(2.0 * 0.1 * 3.0), rel=0.02)


def test_wrong_numbers_are_named():
    with pytest.raises(InputError, match="speed"):
        PursuitConfig(speed=0.0)
    with pytest.raises(InputError, match="needs a path for each robot"):
        PurePursuit([])

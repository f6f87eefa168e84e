"""The bound of steady turns against closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from torchrl_atr.envs import RidingEnv, make_riding_env
from torchrl_atr.envs.tasks import RIDING_REWARDS, riding, walking
from torchrl_atr.evaluation import (
    command_grid,
    envelope_figure,
    figures,
    load_tracking,
    save_tracking,
    tracking_metrics,
)
from torchrl_atr.evaluation.envelope import Envelope, envelope_of
from torchrl_atr.evaluation.metrics import envelope_curve

PRINTED = Envelope(yaw_weight=8.0, lean_weight=30.0, height=0.3, friction=1.0)


def test_turning_pays_up_to_a_speed_and_not_at_all_beyond():
    fastest = 8.0 * (1 - math.exp(-2.0)) * 9.81 / (30.0 * 0.3)  # of c_ω = 1: 7.54 m/s
    speeds = np.array([0.0, fastest - 0.01, fastest + 0.01])
    np.testing.assert_allclose(PRINTED.best_yaw_rate(speeds, [1.0, -1.0]), [[1, 1], [1, 1], [0, 0]])
    np.testing.assert_allclose(PRINTED.yaw_error(-speeds, [1.0]), [[0], [0], [1]])


def test_best_turn_is_the_best_of_all_turns():
    speeds, yaw_rates = np.linspace(-15, 15, 13), np.linspace(-2, 2, 9)
    slippery = dataclasses.replace(PRINTED, friction=0.4)
    for i, v in enumerate(np.abs(speeds)):
        for j, asked in enumerate(np.abs(yaw_rates)):
            turns = np.linspace(0, min(asked, 0.4 * 9.81 / v) if v else asked, 1001)
            reward = 8 * np.exp(-(asked - turns) / 0.5) - 30 * 0.3 * v * turns / 9.81
            assert slippery.best_yaw_rate(speeds, yaw_rates)[i, j] == pytest.approx(turns[reward.argmax()], abs=1e-9)


def test_friction_alone_holds_what_the_hyperbola_encloses():
    # of ±15 × ±2: |v ω| <= μ g; within 0.3 rad/s of what is asked, |v| (|ω| - 0.3) <= μ g
    limit = 9.81
    exact = limit / 30 * (1 + math.log(30 / limit))
    assert PRINTED.share(15, 2, reward=False, error=0.0) == pytest.approx(exact, abs=2e-3)
    corner = limit / 1.7
    near = (2 * corner + 0.3 * (15 - corner) + limit * math.log(15 / corner)) / 30
    assert PRINTED.share(15, 2, reward=False) == pytest.approx(near, abs=2e-3)
    assert np.mean(PRINTED.follows(*command_grid(15, 2, 1, 0.1), reward=False)) == pytest.approx(0.77, abs=0.005)


@pytest.mark.parametrize(("height", "share"), [(0.3, 0.57), (0.5, 0.40)])
def test_share_under_the_printed_reward(height, share):
    envelope = dataclasses.replace(PRINTED, height=height)
    assert envelope.share(15, 2) == pytest.approx(share, abs=0.005)
    assert envelope.share(2, 1) == 1.0


def test_share_is_the_integral_of_the_fastest_speed_over_yaw_rates():
    yaw_rates = np.linspace(0.3, 2.0, 20001)
    fastest = 8 * (1 - np.exp(-2 * yaw_rates)) * 9.81 / (30 * 0.3 * yaw_rates)
    area = 0.3 * 15 + np.trapezoid(np.minimum(fastest, 15), yaw_rates)  # what is within 0.3 of standing still is free
    assert PRINTED.share(15, 2) == pytest.approx(area / 30, abs=2e-3)


@pytest.mark.parametrize("transporter", ["single_board", "two_board"])
def test_numbers_come_from_the_task(transporter):
    task = riding("spot", transporter)
    found = Envelope.of(task)
    lean = 30.0 if transporter == "single_board" else 0.0  # two boards do not tilt to the side
    assert found == Envelope(8.0, lean, task.robot.standing_height + 0.025, 1.0)
    twice = {**RIDING_REWARDS, "steering_command": RIDING_REWARDS["steering_command"].weighted(16.0)}
    assert Envelope.of(task.replace(rewards=twice)).yaw_weight == 16.0
    assert Envelope.of(task, height=0.2).height == 0.2


def test_other_tasks_have_none():
    task = riding()
    assert Envelope.of(walking()) is None
    without = {name: term for name, term in task.rewards.items() if name != "steering_command"}
    assert Envelope.of(task.replace(rewards=without, tracking_rewards=())) is None


def test_envelope_of_an_env_under_its_transforms():
    env = make_riding_env("go1", "two_board", num_envs=1, num_threads=1)
    assert envelope_of(env) == Envelope.of(riding("go1", "two_board"))
    assert envelope_of(RidingEnv(num_envs=1, num_threads=1)) is not None


def test_metrics_report_the_area_as_a_share_of_it(evaluate, tmp_path):
    result = evaluate(lambda command: command * (command[:, :1] < 5), commands=([0.0, 4.0, 10.0], [0.0, 1.0]))
    assert tracking_metrics(result)["envelope"] is None
    assert tracking_metrics(result)["commands_mastered_of_envelope"] is None
    assert envelope_curve(result) is None
    bounded = dataclasses.replace(result, envelope=PRINTED)
    metrics = tracking_metrics(bounded)
    assert metrics["envelope"] == {
        "commands": pytest.approx(5 / 6),  # 10 m/s at 1 rad/s is beyond
        "friction": pytest.approx(1.0),
        **dataclasses.asdict(PRINTED),
    }
    assert metrics["commands_mastered"] == pytest.approx(4 / 6)  # both at 10 m/s are not
    assert metrics["commands_mastered_of_envelope"] == pytest.approx(4 / 5)
    curve = envelope_curve(bounded)
    assert curve[0] == pytest.approx(5 / 6)
    assert curve[-1] == 1.0
    save_tracking(bounded, tmp_path / "tracking.npz")
    assert load_tracking(tmp_path / "tracking.npz").envelope == PRINTED


def test_figures_show_it(evaluate, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, "save", lambda figure, path: drawn.append(figure) or path)
    bounded = evaluate(lambda command: command, commands=command_grid(15, 2, 5, 0.5))
    for result, lines in ((bounded, 0), (dataclasses.replace(bounded, envelope=PRINTED), 2)):
        figures.plot_heatmaps(result, tmp_path / "heatmaps.png")
        contours = [c for axis in drawn[-1].axes[:6] for c in axis.collections if type(c).__name__ == "QuadContourSet"]
        assert len(contours) == 6 * lines
        figures.plot_command_area(result, tmp_path / "area.png")
        black = [line for line in drawn[-1].axes[1].lines if line.get_color() == "black"]
        assert len(black) == (lines > 0)
    np.testing.assert_allclose(black[0].get_ydata(), envelope_curve(dataclasses.replace(bounded, envelope=PRINTED)))


def test_its_own_figure_bounds_turns_by_friction_and_by_the_reward(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(envelope_figure, "save", lambda figure, path: drawn.append(figure) or path)
    envelope_figure.plot_envelope(PRINTED, tmp_path / "envelope.png", max_speed=15.0, max_yaw_rate=2.0)
    _, friction, reward = (c for c in drawn[0].axes[0].collections if type(c).__name__ == "QuadContourSet")
    for bound, largest in ((friction, PRINTED.friction_yaw_rate), (reward, PRINTED.best_yaw_rate)):
        v, w = np.abs(np.concatenate([path.vertices for path in bound.get_paths()])).T
        inner = (v < 14.5) & (w < 1.9) & (v > 0.1)
        assert inner.any()
        within, beyond = w[inner] - 0.05, w[inner] + 0.05
        assert all(largest([a], [b])[0, 0] == pytest.approx(b) for a, b in zip(v[inner], within))
        assert all(largest([a], [b])[0, 0] < b for a, b in zip(v[inner], beyond))

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from torchrl_atr.evaluation import command_area, command_grid, do_nothing_baseline, tracking_metrics


def test_a_perfect_tracker_scores_full_marks(evaluate):
    metrics = tracking_metrics(evaluate(lambda command: command))
    assert metrics["n"] == 18
    assert metrics["survival"] == 1.0
    assert metrics["settled_speed_error"] == metrics["settled_speed_error_straight"] == 0.0
    assert metrics["settled_yaw_error"] == 0.0
    assert metrics["yaw_slope"] == pytest.approx(1.0)
    assert set(metrics["yaw_slope_by_speed"]) == {"-1", "0", "2"}
    assert list(metrics["yaw_slope_by_speed"].values()) == pytest.approx([1.0] * 3)
    for kind in ("rms", "settled"):
        assert all(set(curve) == {1.0} for curve in metrics["command_area"][kind].values())


def test_doing_nothing_scores_the_commands_themselves(evaluate):
    """The analytic figures, and those of a policy that does nothing, are the same."""
    metrics = tracking_metrics(evaluate(torch.zeros_like))
    still = metrics["do_nothing"]
    assert still["survival"] == 1.0
    assert still["settled_speed_error"] == pytest.approx((1 + 0 + 2) / 3)
    assert still["settled_yaw_error"] == pytest.approx((0.5 + 0 + 0.5) / 3)
    assert still["yaw_slope"] == 0.0
    # within 0.5: one of three speeds, all yaw rates; both at once where c_v = 0
    at = metrics["command_area"]["epsilon"].index(0.5)
    assert still["command_area"]["rms"]["speed"][at] == pytest.approx(1 / 3)
    assert still["command_area"]["rms"]["yaw"][at] == 1.0
    assert still["command_area"]["rms"]["combined"][at] == pytest.approx(1 / 3)
    assert {name: metrics[name] for name in still} == still


def test_do_nothing_on_the_default_grid(evaluate):
    still = tracking_metrics(evaluate(lambda command: command, commands=command_grid(), robots=1))["do_nothing"]
    assert still["settled_speed_error"] == pytest.approx(1.2)
    assert still["settled_speed_error_straight"] == pytest.approx(1.2)
    assert still["settled_yaw_error"] == pytest.approx(5 / 9)


def test_straight_means_slow_and_without_yaw(evaluate):
    """Off by 1 at c_ω = 0 and |c_v| <= 2, by 10 elsewhere."""

    def biased(command):
        straight = (command[:, 1] == 0) & (command[:, 0].abs() <= 2)
        return command + torch.where(straight, 1.0, 10.0)[:, None] * torch.tensor([1.0, 0.0])

    metrics = tracking_metrics(evaluate(biased, commands=([-2.0, 0.0, 2.0, 3.0], [-0.5, 0.0])))
    assert metrics["settled_speed_error_straight"] == pytest.approx(1.0)
    assert metrics["settled_speed_error"] == pytest.approx((3 * 1 + 5 * 10) / 8)


def test_the_slope_has_an_intercept_and_leaves_out_large_commands(evaluate):
    """ω = 0.3 + c_v + c_ω / 2 up to 1 rad/s, anything beyond."""

    def steer(command):
        yaw = 0.3 + command[:, 0] + 0.5 * command[:, 1] + 50.0 * (command[:, 1] > 1)
        return torch.stack([command[:, 0], yaw], -1)

    metrics = tracking_metrics(evaluate(steer, commands=([0.0, 1.0], [-1.0, 0.0, 1.0, 2.0])))
    assert metrics["yaw_slope"] == pytest.approx(0.5, abs=1e-6)
    assert metrics["yaw_slope_by_speed"] == pytest.approx({"0": 0.5, "1": 0.5}, abs=1e-6)


def test_the_fallen_count_against_survival_and_area_only(evaluate):
    """Robots asked to go forward fall at once; the others are perfect."""

    def timid(command):
        return torch.where((command[:, :1] > 0), torch.tensor(torch.nan), command)

    metrics = tracking_metrics(evaluate(timid))
    assert metrics["survival"] == pytest.approx(2 / 3)
    assert metrics["settled_speed_error"] == 0.0
    assert metrics["yaw_slope"] == pytest.approx(1.0)
    assert metrics["yaw_slope_by_speed"]["2"] is None
    assert metrics["command_area"]["rms"]["combined"] == pytest.approx([2 / 3] * 21)


def test_a_fallen_trial_is_outside_every_threshold(evaluate):
    result = evaluate(lambda command: command)
    fallen = replace(result, fall_time=np.full_like(result.fall_time, 1.9))
    assert set(command_area(fallen, [0.0, 100.0])["settled"]["combined"]) == {0.0}


def test_a_command_is_mastered_if_most_of_its_robots_stay_up_and_settle_near_it(evaluate):
    result = evaluate(lambda command: command, commands=([0.0, 1.0], [0.0, 0.5]), robots=3)
    falls, speed, yaw = (
        np.array(value) for value in (result.fall_time, result.settled_speed_error, result.settled_yaw_error)
    )
    falls[0, 0, :2] = 1.9  # two of three
    speed[0, 1, 0] = 0.51  # one of three
    yaw[1, 1, :2] = 0.31
    changed = replace(result, fall_time=falls, settled_speed_error=speed, settled_yaw_error=yaw)
    assert tracking_metrics(result)["commands_mastered"] == 1.0
    assert tracking_metrics(changed)["commands_mastered"] == 0.5
    assert tracking_metrics(changed)["do_nothing"]["commands_mastered"] == 0.25


def test_half_of_the_robots_are_not_most(evaluate):
    result = evaluate(lambda command: command, commands=([0.0], [0.0]), robots=2)
    half = replace(result, fall_time=np.array([[[1.9, np.nan]]]))
    assert tracking_metrics(half)["commands_mastered"] == 0.0


def test_the_area_is_of_the_box(evaluate):
    area = command_area(evaluate(lambda command: command))
    assert area["total"] == pytest.approx(3.0 * 1.0)


def test_area_curves_rise_and_combine(random_result):
    area = command_area(random_result)
    for kind in ("rms", "settled"):
        curves = {name: np.array(curve) for name, curve in area[kind].items()}
        assert all((np.diff(curve) >= 0).all() for curve in curves.values())
        assert (curves["combined"] <= np.minimum(curves["speed"], curves["yaw"])).all()


def test_json_knows_no_nan(evaluate, random_result):
    """With falls, with no survivor at all, and with a single command that has no slope."""
    nobody = evaluate(lambda command: torch.full_like(command, torch.nan))
    single = evaluate(lambda command: command, commands=([1.0], [0.5]))
    for result in (random_result, nobody, single):
        metrics = tracking_metrics(result)
        assert json.loads(json.dumps(metrics, allow_nan=False)) == metrics
    metrics = tracking_metrics(nobody)
    assert metrics["survival"] == 0.0
    assert metrics["settled_speed_error"] is None
    assert tracking_metrics(single)["yaw_slope"] is None
    assert tracking_metrics(single)["settled_speed_error_straight"] is None


def test_do_nothing_keeps_the_shape(random_result):
    still = do_nothing_baseline(random_result)
    assert still.survived.all()
    assert still.rms_yaw_error.shape == random_result.rms_yaw_error.shape
    assert still.estimators is None

import json
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from matplotlib import image
from tensordict.nn import TensorDictModule

from torchrl_atr.cli.printing import endurance_lines
from torchrl_atr.evaluation import endurance_metrics, load_endurance, save_endurance, write_endurance
from torchrl_atr.evaluation.access import Component
from torchrl_atr.evaluation.endurance_figure import plot_endurance
from torchrl_atr.evaluation.endurance_metrics import compare_fallen, errors_over_time, survival_over_time
from torchrl_atr.evaluation.intervals import wilson

CAUSES = ["", "tilted", "tilted", "overspeed"]


@pytest.fixture
def result(endure):
    """Four perfect riders of four seconds, three of which fall after 0.5, 1.5 and 3.5 s; made-up intrinsics."""
    ride = endure(lambda command: command, seconds=4.0)
    intrinsics = np.array([[0.0, 1.0], [0.5, 1.0], [0.6, 1.0], [0.7, 1.0]])
    up = np.array([[10, 5, 10, 10], [10, 0, 5, 10], [10, 0, 0, 10], [10, 0, 0, 5]], dtype=float)
    return replace(
        ride,
        fall_time=np.array([np.nan, 0.5, 1.5, 3.5]),
        fall_cause=np.array(CAUSES),
        since_push=np.array([np.nan, np.nan, 0.5, 2.5]),
        since_command=np.array([np.nan, 0.5, 0.5, 0.5]),
        push_seconds=3.0,
        up_steps=up,
        intrinsics=intrinsics,
        intrinsic_names=("payload", "friction"),
    )


def test_survival_by_hand(result):
    metrics = endurance_metrics(result)
    curve = metrics["survival_over_time"]
    assert curve["seconds"] == [0, 1, 2, 3, 4]
    assert curve["share"] == [1.0, 0.75, 0.5, 0.5, 0.25]
    assert list(zip(curve["low"], curve["high"])) == [wilson(count, 4) for count in (4, 3, 2, 2, 1)]
    assert metrics["survival"] == 0.25
    assert metrics["survival_interval"] == list(wilson(1, 4))
    assert (metrics["protocol"], metrics["seconds"], metrics["n"], metrics["falls"]) == ("endurance", 4.0, 4, 3)
    assert metrics["falls_per_minute"] == pytest.approx(3 / (9.5 / 60))


def test_a_fall_at_a_second_counts_there_and_the_end_is_there_too(result):
    odd = replace(result, seconds=3.7, fall_time=np.array([1.0, 3.6, np.nan, np.nan]))
    curve = survival_over_time(odd)
    assert curve["seconds"] == [0, 1, 2, 3, 3.7]
    assert curve["share"] == [1.0, 0.75, 0.75, 0.75, 0.5]


def test_falls_by_cause(result):
    causes = endurance_metrics(result)["falls_by_cause"]
    assert list(causes) == ["tilted", "overspeed"]
    assert causes["tilted"] == {"falls": 2, "share": 0.5, "share_interval": list(wilson(2, 4))}


def test_falls_after_pushes_and_changes(result):
    after = endurance_metrics(result)["falls_after"]
    assert (after["push"]["falls"], after["push"]["share"]) == (1, pytest.approx(1 / 3))
    assert after["push"]["expected"] == pytest.approx(1 / 4)  # one push in 4 s
    assert after["push"]["median"] == 1.5
    assert (after["command"]["falls"], after["command"]["expected"]) == (3, 1.0)
    without = endurance_metrics(replace(result, push_seconds=np.nan, since_push=np.full(4, np.nan)))
    assert without["push_seconds"] is without["falls_after"]["push"]["expected"] is None


def test_the_fallen_beside_the_others(result):
    fallen = endurance_metrics(result)["fallen"]
    assert fallen["intrinsics"]["payload"]["difference"] == pytest.approx(0.6)
    assert fallen["intrinsics"]["friction"]["difference"] == 0
    at_fall = np.abs(result.commands[[0, 1, 3], [1, 2, 3]])
    assert fallen["speed_command"]["fallen"] == pytest.approx(at_fall[:, 0].mean())
    assert fallen["yaw_command"]["all"] == pytest.approx(np.abs(result.commands[..., 1]).mean())


def test_a_fall_at_the_very_end_of_a_command_is_of_that_command(result):
    speeds = np.arange(1.0, 5.0)[:, None] + 10.0 * np.arange(4.0)
    ends = replace(result, commands=np.stack([speeds, -speeds], -1), fall_time=np.array([np.nan, 1.0, 2.0, 4.0]))
    assert compare_fallen(ends)["speed_command"]["fallen"] == pytest.approx((11 + 22 + 34) / 3)


def test_the_interval_of_a_difference_of_the_fallen_by_hand(result):
    """Standard errors of two values are half their distance: 3 of the fallen, 4 of the others, 5 together."""
    spread = np.array([[-4.0], [4.0], [0.0], [6.0]])
    falls = np.array([np.nan, np.nan, 1.5, 3.5])
    ends = replace(result, fall_time=falls, intrinsics=spread, intrinsic_names=("payload",))
    payload = compare_fallen(ends)["intrinsics"]["payload"]
    assert payload["difference"] == pytest.approx(3.0)
    assert payload["difference_interval"] == pytest.approx([3.0 - 1.96 * 5.0, 3.0 + 1.96 * 5.0])


def test_the_last_second_of_a_ride_may_be_shorter(result):
    assert errors_over_time(replace(result, seconds=3.7))["seconds"] == pytest.approx([0.5, 1.5, 2.5, 3.35])


def test_settled_errors_are_means_over_steps(result):
    """Robot 0 is off by 1 and robot 1, with half as many steps, by 4."""
    errors, steps = np.zeros((4, 4, 2)), np.zeros((4, 4))
    errors[:, 0], errors[:, 1] = (1.0, 0.1), (4.0, 0.4)
    steps[:, 0], steps[:, 1] = 10, 5
    errors[:, 2:] = np.nan
    metrics = endurance_metrics(replace(result, settled_error=errors, settled_steps=steps))
    assert metrics["settled_speed_error"] == pytest.approx(2.0)
    assert metrics["settled_yaw_error"] == pytest.approx(0.2)
    low, high = metrics["settled_speed_error_interval"]
    assert 1.0 <= low < 2.0 < high <= 4.0
    curve = metrics["errors_over_time"]
    assert curve["seconds"] == [0.5, 1.5, 2.5, 3.5]
    assert curve["speed"]["mean"] == pytest.approx([2.0] * 4)


def test_drift_is_that_of_the_survivors(result):
    """The survivor's error grows from 1 to 3; the others', who fall, count for nothing."""
    component = Component("platform_velocity[0]", "platform velocity x", "m/s")
    error = np.full((4, 4, 1), 100.0)
    error[:, 0, 0] = [1.0, 1.0, 2.0, 4.0]
    error[result.up_steps == 0] = np.nan
    metrics = endurance_metrics(replace(result, estimate_error=error, components=(component,)))
    (row,) = metrics["estimates"]
    assert (row["window"], row["first"], row["last"], row["drift"]) == (2, 1.0, 3.0, 3.0)
    assert metrics["estimate_drift"] == 3.0
    assert metrics["estimate_over_time"]["mean"][:2] == pytest.approx([(10 + 25 * 100) / 35, (10 + 15 * 100) / 25])
    assert endurance_metrics(result)["estimate_drift"] is None


def _falling(command):
    return torch.full_like(command, torch.nan)


@pytest.mark.parametrize("ending", ["nobody falls", "everybody falls", "one robot", "one step"])
def test_any_result_is_written_drawn_and_printed(endure, tmp_path, ending):
    options = {"one robot": {"robots": 1}, "one step": {"seconds": 0.1}}.get(ending, {})
    act = _falling if ending == "everybody falls" else lambda command: command
    outs = ["action", ("estimate", "extrinsic")]
    policy = TensorDictModule(lambda c: (act(c), torch.zeros(len(c), 4)), in_keys=["command"], out_keys=outs)
    result = endure(policy, **options)
    metrics = endurance_metrics(result)
    paths = write_endurance(result, metrics, tmp_path / "report")
    assert json.loads(paths["metrics.json"].read_text(encoding="utf-8")) == metrics
    assert {path.name for path in (tmp_path / "report").iterdir()} == set(paths)
    assert metrics["survival"] == (0.0 if ending == "everybody falls" else 1.0)
    lines = list(endurance_lines(metrics))
    assert {len(line.rstrip()) <= 84 for line in lines} == {True}
    assert any(line.startswith("up at ") for line in lines)


def test_the_headline(result):
    lines = [line.split() for line in endurance_lines(endurance_metrics(result))]
    assert lines[0] == ["ours", "95", "%", "interval", "still", "board"]
    low, high = (f"{end:.3f}" for end in wilson(1, 4))
    assert ["up", "at", "4", "s,", "share", "0.250", f"[{low},", f"{high}]", "1.000"] in lines
    assert lines[-2][:3] == ["tilted,", "share", "0.500"]


def test_the_figure_shows_a_result(result, tmp_path):
    pixels = np.round(image.imread(plot_endurance(endurance_metrics(result), tmp_path / "a.png"))[..., :3] * 255)
    coloured = pixels.reshape(-1, 3)[np.ptp(pixels.reshape(-1, 3), axis=1) > 30]
    assert len(np.unique(coloured, axis=0)) > 10


def test_a_result_survives_a_round_trip(result, tmp_path):
    component = Component("a", "a", None)
    full = replace(result, estimate_error=np.ones((4, 4, 1)), components=(component,), latent_error=np.ones((4, 4)))
    for each in (result, full):
        again = load_endurance(save_endurance(each, tmp_path / "endurance.npz"))
        for field in fields(each):
            ours, theirs = getattr(each, field.name), getattr(again, field.name)
            if isinstance(ours, np.ndarray):
                np.testing.assert_array_equal(ours, theirs)
            else:
                assert ours == theirs
        assert endurance_metrics(again) == endurance_metrics(each)


def test_a_file_that_is_no_endurance_file_is_named(tmp_path):
    np.savez(tmp_path / "other.npz", seconds=1.0)
    with pytest.raises(KeyError, match=r"other\.npz lacks commands"):
        load_endurance(tmp_path / "other.npz")

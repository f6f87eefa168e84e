"""The robustness sweep: its conditions follow from the task, they are in force, and a stopped one goes on."""

from __future__ import annotations

import json
from functools import partial
from itertools import pairwise

import pytest
from matplotlib import image
from tensordict.nn import TensorDictModule

from torchrl_atr.cli.printing import robustness_lines
from torchrl_atr.envs import make_riding_env, riding
from torchrl_atr.envs.tasks.intrinsic_parameters import IntrinsicParameter
from torchrl_atr.evaluation import conditions, robustness
from torchrl_atr.evaluation.conditions import BASELINE, Sweep, sweeps_of
from torchrl_atr.evaluation.robustness import evaluate_robustness, robustness_table
from torchrl_atr.evaluation.robustness_figure import plot_robustness

SHORT = {"robots": 2, "seconds": 0.04, "command_seconds": 0.04, "settle": 0.0}
STAND = TensorDictModule(lambda o: o.new_zeros(len(o), 12), ["observation"], ["action"])


@pytest.fixture(scope="module")
def task():
    return riding("a1", "single_board", sensors="realistic")


def values(task, name):
    return [(condition.value, condition.region) for condition in sweeps_of(task)[name].conditions]


def test_values_go_out_from_the_training_range_over_the_test_range_and_as_far_beyond(task):
    train, test, beyond = "training", "test", "beyond"
    assert values(task, "payload") == [(1.0, train), (3.0, test), (5.0, beyond), (9.0, beyond)]
    low, high = values(task, "friction")[:4], values(task, "friction")[4:]
    assert [value for value, _ in low] == pytest.approx([0.4, 0.6, 0.7, 0.8])
    assert [value for value, _ in high] == pytest.approx([1.2, 1.5, 1.8, 2.4])
    assert values(task, "kd")[0][0] == pytest.approx(0.4)  # no gain below zero
    assert {name for name in sweeps_of(task) if "com" in name} == {f"com_shift[{i}]" for i in range(3)}


def test_without_a_test_range_the_step_is_the_training_ranges_half():
    only = IntrinsicParameter(lambda *_: None, (-1.0, 1.0), nominal=0.0)
    assert conditions._outwards(only, 1) == [(1.0, "training"), (2.0, "beyond"), (4.0, "beyond")]


def test_together_holds_every_parameter_and_widens(task):
    stages = [condition.ranges for condition in sweeps_of(task)["together"].conditions]
    assert [stage["payload"] for stage in stages] == [(0.0, 1.0), (0.0, 3.0), (0.0, 5.0), (0.0, 9.0)]
    assert all(set(stage) == set(task.intrinsics) for stage in stages)
    for inner, outer in pairwise(stages):
        assert all(outer[name][0] <= inner[name][0] and inner[name][1] <= outer[name][1] for name in inner)


def test_sensors_are_those_of_training_times_a_factor(task):
    worst = sweeps_of(task)["sensor_errors"].conditions[-1]
    assert worst.sensors["joint_position"]["noise"] == pytest.approx(4 * 0.005)
    assert worst.sensors["joint_position"]["delay"] == 1.0
    ideal = sweeps_of(riding("a1", sensors="ideal"))["sensor_errors"]
    assert (ideal.training, [c.region for c in ideal.conditions][:2]) == ((0.0, 0.0), ["training", "beyond"])


def test_an_unknown_parameter_is_named(task):
    with pytest.raises(ValueError, match="no parameter 'payloed' to sweep; did you mean 'payload'"):
        sweeps_of(task, ["payloed"])


def test_conditions_are_in_force_and_a_stopped_sweep_goes_on(monkeypatch, tmp_path):
    monkeypatch.setattr(conditions, "ACTION_DELAYS", (0.01,))
    monkeypatch.setattr(conditions, "SENSOR_DELAYS", (2.0,))
    seen = []

    def make_env(**arguments):
        env = make_riding_env("a1", "single_board", num_threads=1, sensors="realistic", **arguments)
        seen.append(env)
        return env

    saved = []
    names = ["com_shift[1]", "sensor_delay", "action_delay"]
    measure = partial(evaluate_robustness, STAND, make_env, **SHORT)
    monkeypatch.setattr(conditions, "BEYOND", ())
    metrics = measure(names, save=saved.append)
    rides = [env for env in seen if env.batch_size[0] == 2]
    shifts = [env.base_env.runner.intrinsics.values(env.base_env.runner.x_int)["com_shift"] for env in rides]
    assert shifts[1][:, 1].tolist() == pytest.approx([-0.25] * 2)
    assert (shifts[1][:, 0] - shifts[0][:, 0]).abs().max() < 1e-6  # the same robots but for what is varied
    errors = rides[5].base_env.runner.sensor_errors
    assert float(errors._latest["proprio"]["delay"].max()) == 2.0
    assert rides[6].base_env.engine.action_delay == 0.01
    assert [row["condition"]["parameter"] for row in saved[-1]][:2] == [BASELINE, "com_shift[1]"]
    assert len(saved) == 7
    stopped, before = json.loads(json.dumps(saved[-1][:6])), len(seen)
    assert measure(names, finished=stopped) == metrics
    assert len([env for env in seen[before:] if env.batch_size[0] == 2]) == 1


def row(value, region, up):
    figures = {"settled_speed_error": 0.3, "settled_yaw_error": 0.1 if up else None}
    ends = {f"{name}_interval": [0.05, 0.4] for name in figures}
    up = {"survival": up, "survival_interval": [max(0.0, up - 0.1), min(1.0, up + 0.1)]}
    return {"value": value, "region": region, "n": 20, **up, **figures, **ends}


def test_where_it_breaks_is_next_to_the_training_range_on_both_sides():
    shares = {0.2: 0.0, 0.5: 0.2, 0.8: 0.9, 1.6: 0.3, 2.0: 0.1}
    rows = [{"value": value, "survival": up} for value, up in shares.items()]
    assert robustness.breaks_at(rows, 0.9, (0.8, 1.2)) == [0.5, 1.6]


def test_broken_is_less_than_half_of_those_up_in_training():
    """Of 60 % in training half is 30 %: 40 % is not broken, 20 % is."""
    rows = [
        {"condition": {"parameter": parameter, "value": value, "region": ""}, "n": 10, "survival": up}
        for parameter, value, up in ((BASELINE, "training", 0.6), ("payload", 3.0, 0.4), ("payload", 5.0, 0.2))
    ]
    metrics = robustness.robustness_metrics(rows, {"payload": Sweep("payload", "kg", (), (0.0, 1.0))}, {})
    assert metrics["parameters"]["payload"]["breaks_at"] == [5.0]


def test_the_report_says_and_shows_where_it_breaks(tmp_path):
    payload = [row(1.0, "training", 0.9), row(3.0, "test", 0.7), row(5.0, "beyond", 0.4), row(9.0, "beyond", 0.0)]
    solver = [row("cg", "beyond", 0.9), row("without no-slip", "beyond", 0.1)]
    sweeps = {
        "payload": {"unit": "kg", "training": [0.0, 1.0], "test": [0.0, 3.0], "rows": payload},
        "solver": {"unit": "", "training": None, "test": None, "rows": solver},
    }
    for sweep in sweeps.values():
        sweep["breaks_at"] = robustness.breaks_at(sweep["rows"], 0.9, sweep["training"])
    assert [sweep["breaks_at"] for sweep in sweeps.values()] == [[5.0], ["without no-slip"]]
    ride = {"seconds": 20.0, "command_seconds": 5.0, "push_seconds": None}
    metrics = {"n": 20, **ride, "baseline": row("training", "training", 0.9), "parameters": sweeps}
    table = "\n".join(robustness_table(metrics))
    assert "| payload | 90% [80%, 100%] at 1 kg | 70% [60%, 80%] at 3 kg | 0% [0%, 10%] at 9 kg | 5 kg |" in table
    assert "no pushes" in table
    assert [line.split()[-2:] for line in robustness_lines(metrics)][1] == ["5", "kg"]
    assert image.imread(plot_robustness(metrics, tmp_path / "robustness.png")).shape[1] > 500

"""The benchmark runs, and its ratios follow from its figures. What it measures is no matter of a test."""

from __future__ import annotations

import dataclasses
import json
import time

import numpy as np
import pytest

from benchmarks import bench, contenders, summary
from benchmarks.stopwatch import Stopwatch
from benchmarks.timing import Contender, Key, interleave, medians
from torchrl_atr import cli
from torchrl_atr.cli import commands
from torchrl_atr.envs import RidingEnv
from torchrl_atr.training import TrainConfig


def test_one_run_measures_everything_and_says_where(tmp_path):
    assert cli.main(["bench", "--quick", "--output", str(tmp_path)]) == 0
    results, text = json.loads((tmp_path / "bench.json").read_text()), (tmp_path / "bench.md").read_text()
    rates = {(r["name"], r["num_envs"], r["threads"]): r["median"] for r in results["rates"]}
    ours = {"physics", *summary.LADDER, "training", "training_riding"}
    assert {name for name, *_ in rates} >= ours | {"dm_control", "torchrl_ant"} - set(results["skipped"])
    assert all(len(r["samples"]) == bench.QUICK.rounds and min(r["samples"]) > 0 for r in results["rates"])
    assert all(r["peak"] >= r["imported"] > 0 for r in results["memory"])
    check_origin(results)
    check_ratios(results, rates)
    check_compute(results["compute"]["flops_per_frame"])
    check_profile(results["profile"])
    for title in ("Layers", "Training", "Peers", "Robots and threads", "Memory", "Where a training iteration goes"):
        assert f"## {title}" in text
    assert results["machine"]["processor"] in text
    assert all(reason in text for reason in results["skipped"].values())


def check_origin(results):
    assert results["command"] == "torchrl-atr bench --quick"
    assert {"processor", "cpus", "torch_threads", "load_before", "load_after"} <= set(results["machine"])
    assert {"torch", "torchrl", "mujoco"} <= set(results["versions"])
    assert results["date"].endswith("UTC")
    assert "mjbatch" in results["skipped"]


def check_ratios(results, rates):
    size, cpus = bench.QUICK.num_envs, bench.QUICK.cpus
    physics = rates["physics", size, cpus]
    assert results["ladder"] == {name: pytest.approx(rates[name, size, cpus] / physics) for name in summary.LADDER}
    (training,), compute = results["training"], results["compute"]
    limit = compute["flops_per_second"] / compute["flops_per_frame"]
    assert training["compute"] == pytest.approx(limit)
    for kind, name in {"": "training", "riding_": "training_riding"}.items():
        wanted = rates[name, size, cpus] * (1 / physics + 1 / limit)
        assert training[f"{kind}efficiency"] == pytest.approx(wanted)
    for name, peer in results["peers"].items():
        assert peer["ours_over_it"] == pytest.approx(rates["free", size, cpus] / rates[name, cpus, cpus])
    (row,) = results["scaling"]
    assert row["bare_of_physics"] == pytest.approx(row["bare"] / row["physics"])


def check_compute(flops):
    # the actor alone: forward once in the rollout, forward and backward in each epoch
    layers = [(79, 512), (512, 256), (256, 128), (128, 12)]
    forward = sum(2 * i * o for i, o in layers)
    assert 3 * TrainConfig().ppo.epochs * forward < flops < 20 * forward


def check_profile(profile):
    seconds = {phase["name"]: phase["seconds"] for phase in profile["phases"]}
    assert all(seconds[name] > 0 for name in ("physics", "task", "policy", "collector", "GAE", "PPO", "estimators"))
    assert sum(summary.shares(list(seconds.values()))) == pytest.approx(1.0)


def test_an_installed_package_says_to_use_a_clone(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(commands, "__file__", str(tmp_path / "torchrl_atr" / "cli" / "commands.py"))
    assert cli.main(["bench", "--output", str(tmp_path / "out")]) == 2
    assert "run it from a clone" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_contenders_take_turns():
    turns = []
    both = [Contender(Key(name, 1, 1), lambda name=name: turns.append(name) or 1) for name in "ab"]
    rates = interleave(both, rounds=2, seconds=0.0)
    assert turns == list("aabb" * 3)  # the first round does not count, and the first step of each turn
    assert medians({both[0].key: [1.0, 5.0, 2.0]}) == {both[0].key: 2.0}
    assert [len(samples) for samples in rates.values()] == [2, 2]


def test_a_phase_does_not_count_what_runs_inside_another():
    class Kitchen:
        def cook(self):
            for _ in self.chop():
                time.sleep(0.01)

        def chop(self):
            for _ in range(3):
                time.sleep(0.02)
                yield

    watch, kitchen = Stopwatch(), Kitchen()
    watch.attach(kitchen, "cook", "cooking")
    watch.attach(kitchen, "chop", "chopping")
    start = time.perf_counter()
    kitchen.cook()
    elapsed = time.perf_counter() - start
    assert watch.seconds["chopping"] >= 0.06
    assert watch.seconds["cooking"] >= 0.03
    assert sum(watch.seconds.values()) <= elapsed
    watch.detach()
    assert not vars(kitchen)


def test_sizes_and_threads_are_measured_once_each():
    layers = bench._layers(dataclasses.replace(bench.FULL, cpus=6, sizes=(64, 1024)))
    points = [make.args for make in layers if make.func is contenders.physics]
    assert sorted(points) == [(64, 6), (1024, 1), (1024, 2), (1024, 4), (1024, 6)]
    eager = [make.keywords["name"] for make in layers if not make.keywords.get("compiled") and make.keywords]
    assert eager == list(summary.EAGER)


def test_robots_at_the_physics_limit_stand():
    scene = RidingEnv(num_envs=1, randomization="off", seed=0).scene
    step, height = contenders.standing_step(scene, num_envs=2, threads=1), scene.layout.root_qpos + 2
    heights = [step().qpos[:, height].copy() for _ in range(2 * contenders.STAND_STEPS)]
    assert np.allclose(heights, scene.model.key("stand").qpos[height], atol=0.05)

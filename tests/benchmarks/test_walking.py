"""The benchmark of walking trains, measures and writes its page; strides are counted as they are."""

from __future__ import annotations

import json

import pytest
import torch

from benchmarks import walking
from torchrl_atr.deploy.manifest import read_manifest


def test_air_times_and_heights_are_those_of_whole_swings():
    bears = torch.tensor([0, 1, 0, 0, 0, 1, 1, 0, 1, 0], dtype=torch.bool)  # cut off, three steps, one step, cut off
    heights = torch.tensor([9.0, 0.0, 0.02, 0.05, 0.01, 0.0, 0.0, 0.03, 0.0, 9.0])
    figures = walking.strides(bears[:, None, None].expand(-1, 2, 4), heights[:, None, None].expand(-1, 2, 4))
    assert figures == pytest.approx({"air_time": 0.04, "swing_height": 0.04})
    still = torch.ones(5, 1, 4, dtype=torch.bool)
    assert walking.strides(still, still.float()) == {"air_time": 0.0, "swing_height": 0.0}


def test_it_trains_measures_and_goes_on_where_it_was(tmp_path, monkeypatch):
    small = {"SECONDS": 0.1, "SETTLE": 0.02, "COPIES": 1, "GAIT_SECONDS": 0.1, "GAIT_ROBOTS": 2, "SPEEDS": (0.0, 1.0)}
    for name, value in small.items():
        monkeypatch.setattr(walking, name, value)
    tiny = {
        "env.num_envs": 8,
        "ppo.rollout_steps": 4,
        "compute.compiled": False,
        "compute.num_threads": 1,
        "compute.torch_threads": 1,
    }
    make = walking.make_config
    monkeypatch.setattr(walking, "make_config", lambda settings: make({**settings, **tiny}))
    folders = [f"--{name}={tmp_path / name}" for name in ("runs", "output", "policies")]
    assert walking.main(["--robots", "a1", "--frames", "32", *folders]) == 0
    report = json.loads((tmp_path / "output" / "walking.json").read_text())["robots"]
    assert report["a1"]["run"]["frames"] == 32
    assert {row["n"] for row in report["a1"]["evaluations"].values()} == {2 * len(walking.YAW_RATES)}
    assert [row["command"] for row in report["a1"]["gait"]] == [1.5]
    bundle = read_manifest(tmp_path / "policies" / "a1-walking")
    assert bundle["training"]["frames"] == 32
    assert bundle["figures"]["train"]["n"] == 10
    assert "| a1 | 0 | 32 | train range | 10 |" in (tmp_path / "policies" / "a1-walking" / "README.md").read_text()
    (tmp_path / "runs" / "a1" / "checkpoint.pt").unlink()  # not read again
    assert walking.main(["--robots", "spot", "--frames", "32", *folders]) == 0
    page = (tmp_path / "output" / "README.md").read_text()
    assert all(f"| {robot} | 0 | 32 | train range | 10 | 100% [" in page for robot in ("a1", "spot"))
    assert walking.main(["--robots", "a1", "--frames", "64", *folders]) == 2  # a run of other settings

"""The benchmark of walking trains, measures and writes its page; strides are counted as they are."""

from __future__ import annotations

import json

import pytest
import torch

from benchmarks import walking


def test_air_times_and_heights_are_those_of_whole_swings():
    bears = torch.tensor([0, 1, 0, 0, 0, 1, 1, 0, 1, 0], dtype=torch.bool)  # cut off, three steps, one step, cut off
    heights = torch.tensor([9.0, 0.0, 0.02, 0.05, 0.01, 0.0, 0.0, 0.03, 0.0, 9.0])
    figures = walking.strides(bears[:, None, None].expand(-1, 2, 4), heights[:, None, None].expand(-1, 2, 4))
    assert figures == pytest.approx({"air_time": 0.04, "swing_height": 0.04})
    still = torch.ones(5, 1, 4, dtype=torch.bool)
    assert walking.strides(still, still.float()) == {"air_time": 0.0, "swing_height": 0.0}


def test_it_trains_measures_and_goes_on_where_it_was(tmp_path, monkeypatch):
    small = {"SECONDS": 0.1, "SETTLE": 0.02, "ROBOTS": 1, "GAIT_SECONDS": 0.1, "GAIT_ROBOTS": 2, "SPEEDS": (0.0, 1.0)}
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
    folders = ["--run", str(tmp_path / "run"), "--output", str(tmp_path / "report")]
    assert walking.main(["--frames", "32", *folders]) == 0
    report = json.loads((tmp_path / "report" / "walking.json").read_text())
    assert report["run"]["frames"] == 32
    assert {row["n"] for row in report["tracking"].values()} == {2 * len(walking.YAW_RATES)}
    assert [row["command"] for row in report["gait"]] == [1.0]
    page = (tmp_path / "report" / "README.md").read_text()
    assert "| train range | 10 | 100.0% |" in page
    (tmp_path / "run" / "checkpoint.pt").unlink()  # not read again
    assert walking.main(["--frames", "32", *folders]) == 0

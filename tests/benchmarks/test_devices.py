"""The learner's devices, in iterations of a few robots."""

from __future__ import annotations

import json

import torch

from benchmarks import devices


def test_every_size_is_measured_on_every_device_found(tmp_path):
    few = ["--num-envs", "4", "8", "--rounds", "1", "--seconds", "0", "--set", "compute.compiled=false"]
    assert devices.main([*few, "--output", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "devices.json").read_text())["rows"]
    found = ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]
    assert [(row["num_envs"], row["device"]) for row in rows] == [(size, name) for size in (4, 8) for name in found]
    assert all(row[name] > 0 for row in rows for name in devices.COLUMNS)
    readme = (tmp_path / "README.md").read_text()
    assert ("on a CUDA device" in readme) == (found == ["cpu"])
    assert f"| 8 | cpu | {rows[-len(found)]['frames_per_second']:,.0f} |" in readme

"""The benchmark beside other work, on runs of a second."""

from __future__ import annotations

import json

from benchmarks import busy_neighbour


def test_every_case_is_measured_and_compared_with_itself_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(busy_neighbour, "train", lambda folder, minutes, count=1: 1000.0 / count)
    monkeypatch.setattr(busy_neighbour, "evaluate", lambda folder: 2.0)
    assert busy_neighbour.main(["--rounds", "1", "--output", str(tmp_path)]) == 0
    ratios = json.loads((tmp_path / "busy_neighbour.json").read_text())["ratios"]
    assert ratios["each of two trainings"] == 0.5
    assert ratios["train beside a busy process"] == ratios["evaluate beside a busy process"] == 1.0
    assert "| each of two trainings | 500 | 500 to 500 | 0.50 |" in (tmp_path / "README.md").read_text()


def test_the_speed_leaves_the_warm_up_out(tmp_path):
    rows = ["minutes,frames", "0.05,10", "0.1,100", "0.2,700"]
    (tmp_path / "progress.csv").write_text("\n".join(rows))
    assert busy_neighbour._speed(tmp_path) == 100.0

"""The viewer's benchmark rides, steers and writes its page."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("viser")
pytest.importorskip("mjviser")
from benchmarks import viewer


def test_it_rides_steers_and_reports(tmp_path, monkeypatch):
    monkeypatch.setattr(viewer, "WARM_UP", 0.5)
    assert viewer.main(["--seconds", "1", "--drags", "1", "--output", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "viewer.json").read_text())["figures"]
    assert 0.0 < found["rate"] < 1.2
    assert 0.0 < found["latency_ms"][0] == found["latency_ms"][1] < 5000.0
    assert f"at {found['rate']:.3f} times real time" in (tmp_path / "README.md").read_text()

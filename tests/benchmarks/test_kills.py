"""Three kills at random moments; ``python -m benchmarks.kills`` does twenty."""

from __future__ import annotations

import json

from benchmarks import kills


def test_a_killed_run_goes_on_from_its_last_checkpoint(tmp_path):
    assert kills.main(["--kills", "3", "--longest", "1", "--start", "8", "--output", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "kills.json").read_text())
    frames = [(kill["before"], kill["after"]) for kill in report["kills"]]
    assert frames[0][0] == 0
    assert all(after >= before for before, after in frames)
    assert all(after > before for before, after in frames[::2])
    assert [before for before, _ in frames[1:]] == [after for _, after in frames[:-1]]
    assert "Lost: 0." in (tmp_path / "README.md").read_text()

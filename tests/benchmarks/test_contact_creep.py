"""The table of contact models, briefly; what creeps and what does not is with the contacts' own tests."""

from __future__ import annotations

import json

from benchmarks import contact_creep
from benchmarks.contact_creep import CONTACTS, SOFT


def test_report_has_every_model_pair_and_motion(tmp_path, monkeypatch):
    monkeypatch.setattr(contact_creep, "MODELS", (SOFT, CONTACTS))
    monkeypatch.setattr(contact_creep.ROBOTS, "names", lambda: ("a1",))
    output = tmp_path / "creep"
    arguments = ["--seconds", "0.4", "--settle", "0.2", "--robots", "2", "--rounds", "1"]
    assert contact_creep.main(["--output", str(output), *arguments]) == 0
    report = json.loads((output / "contact_creep.json").read_text())
    assert report["command"].startswith("python -m benchmarks.contact_creep --acceleration 3 --seconds 0.4")
    assert [row["transporter"] for row in report["creep"]] == ["single_board"] * 2 + ["two_board"] * 2
    assert all(set(row["mm_per_second"]) == set(contact_creep.MOTIONS) for row in report["creep"])
    assert [row["contacts"] for row in report["cost"]] == [contact_creep.describe(m) for m in (SOFT, CONTACTS)]
    assert all(ms > 0 for row in report["cost"] for ms in row["ms_per_substep"].values())
    text = (output / "README.md").read_text()
    assert text.count("| pyramidal, impratio 1 |") == text.count("| elliptic, impratio 1, 2 no-slip |") == 2


def test_a_robot_that_does_not_stay_up_has_no_figure_and_none_has_its_worst_pair():
    found = contact_creep.creep("anymal_c", "single_board", acceleration=30.0, seconds=4.0, settle=3.0)
    assert found["standing"] is not None
    assert found["accelerating"] is None
    assert contact_creep._worst([1.0, None]) is None
    assert contact_creep._worst([1.0, 2.0]) == 2.0

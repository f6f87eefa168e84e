"""Measurements that are finished are not made again; others are."""

from __future__ import annotations

import pytest

from torchrl_atr.reproduction.parts import Parts


def test_a_part_is_made_once_for_what_was_asked(tmp_path):
    made = []

    def make(folder):
        made.append(folder)
        (folder / "value").write_text("1")

    first = Parts(tmp_path).get("ride", {"seed": 0}, make)
    again = Parts(tmp_path)
    assert again.get("ride", {"seed": 0}, make) == first
    assert (first / "value").read_text() == "1"
    assert len(made) == 1
    assert list(again.seconds) == [first]
    assert again.get("ride", {"seed": 1}, make) != first
    assert len(made) == 2


def test_a_part_that_failed_is_made_anew(tmp_path):
    parts = Parts(tmp_path)
    with pytest.raises(ZeroDivisionError):
        parts.get("ride", {}, lambda folder: 1 / 0)
    assert parts.get("ride", {}, lambda folder: (folder / "value").write_text("1")).is_dir()

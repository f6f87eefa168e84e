"""Standing without acting, on a few robots."""

from __future__ import annotations

import json

from benchmarks import standing

FEW = {"robots": 16, "seed": 0, "num_threads": 1}


def test_centred_a1_stands_where_an_off_centre_one_falls():
    centred, drawn = (standing.survival("a1", "single_board", centred=c, seconds=3.0, **FEW) for c in (True, False))
    assert centred >= 0.8
    assert drawn < centred


def test_more_robots_survive_pushes_in_the_wide_stance():
    more = {**FEW, "robots": 48, "seconds": 8.0}
    own, wide = (
        standing.survival("a1", "single_board", centred=False, pushed=True, wide=w, **more) for w in (False, True)
    )
    assert own < wide


def test_springs_as_printed_let_a_large_robot_fall_sooner():
    scaled, printed = (
        standing.survival("spot", "single_board", centred=True, scaled_springs=s, seconds=2.0, **FEW)
        for s in (True, False)
    )
    assert printed < scaled


def test_cases_are_every_pair_and_the_large_ones_on_both_kinds_of_springs():
    cases = [case for case in standing.cases() if case["robot"] in ("a1", "go1", "anymal_c", "spot")]
    assert len(cases) == (2 * 2 + 2 * 2 * 2) * 2 * 3
    assert all(case["scaled_springs"] for case in cases if case["robot"] in ("a1", "go1"))


def test_report(tmp_path):
    output = tmp_path / "standing"
    assert standing.main(["--output", str(output), "--robots", "2", "--seconds", "0.1"]) == 0
    report = json.loads((output / "standing.json").read_text())
    assert report["command"] == "python -m benchmarks.standing --robots 2 --seconds 0.1 --seed 0"
    text = (output / "README.md").read_text()
    assert "| spot | two_board | as printed | own | 100.0% | 100.0% | 100.0% |" in text
    assert "| a1 | single_board | as printed | wide | 100.0% | 100.0% | 100.0% |" in text

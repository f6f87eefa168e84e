"""Two workers against one process, on a run of a few batches."""

from __future__ import annotations

import json

from benchmarks import workers


def test_both_kinds_are_trained_and_compared(tmp_path):
    arguments = ["--frames", str(5 * 8 * 24), "--seeds", "1", "--num-envs", "8", "--output", str(tmp_path)]
    assert workers.main(arguments) == 0
    returns = json.loads((tmp_path / "workers.json").read_text())["returns"]
    assert {kind: len(values) for kind, values in returns.items()} == {"one process": 1, "two workers": 1}
    row = f"| 0 | {returns['one process'][0]:.2f} | {returns['two workers'][0]:.2f} |"
    assert row in (tmp_path / "README.md").read_text()


def test_the_table_counts_who_lies_between():
    report = {
        "command": "c",
        "wall_seconds": 1,
        "frames": 10,
        "hardware": {"cpus": 2, "processor": "p"},
        "returns": {"one process": [1.0, 3.0], "two workers": [2.0, 4.0]},
    }
    assert "1 of the 2 runs with two workers lie between" in workers.table(report)
    assert "| 1 | 3.00 | 4.00 |" in workers.table(report)

"""What CONTRIBUTING.md promises is so: files exist, are as short as it says, and examples of additions run in tests."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
ADDITIONS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in TEXT[TEXT.index("| to add |") : TEXT.index("Inside the package")].splitlines()[2:]
    if line.startswith("|")
]


def paths(text: str) -> list[str]:
    return re.findall(r"`?((?:torchrl_atr|docs|examples|tests|benchmarks|scripts)/[\w/.]+\.\w+)`?", text)


def test_the_issue_of_every_kind_of_addition_has_a_row():
    kinds = " ".join(row[0] for row in ADDITIONS)
    for kind in ("reward term", "observation", "robot", "estimator", "transporter", "drive law", "task"):
        assert kind in kinds


@pytest.mark.parametrize("row", ADDITIONS, ids=[row[0] for row in ADDITIONS])
def test_reading_what_it_names_takes_no_more_lines_than_it_says(row):
    files = paths(row[1])
    assert files
    assert sum(len((ROOT / file).read_text().splitlines()) for file in files) <= int(row[2])


@pytest.mark.parametrize("row", ADDITIONS, ids=[row[0] for row in ADDITIONS])
def test_its_example_is_run_by_a_test(row):
    (example,) = paths(row[4])
    assert (ROOT / example).is_file()
    stem = Path(example).stem
    tests = "".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    assert re.search(rf"\b{stem}\b", tests), f"no test names {stem}"


def test_every_file_that_it_names_exists():
    for path in paths(TEXT):
        assert (ROOT / path).exists(), path

"""Write the README's results from ``results/``: ``python scripts/readme_results.py``, from the root of a clone."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # benchmarks/ is not installed

from benchmarks.scorecard import row  # noqa: E402
from torchrl_atr.runs.provenance import cores  # noqa: E402

BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
LONG, SHORT = "results/a1-single_board", "results/five_minutes"
ROWS = ("tracking", "area-5x1", "endurance", "endurance-300", "standing-300")


def section() -> str:
    """Return the results as Markdown: a table, and a line of provenance for each policy."""
    card = _read(f"{LONG}/scorecard.json")
    short = _read(f"{SHORT}/metrics.json")
    lines = [
        "## Results",
        "",
        "A1 on the single board, deployed: realistic sensors; hidden parameters (payload, friction, gains, springs of "
        "the board, ...) of the training range; 95 % intervals. Errors are means over robots that are up, after "
        "settling; mastered commands are ridden within 0.5 m/s and 0.3 rad/s.",
        "",
        "| protocol | robots | up at the end | speed error, m/s | yaw error, rad/s | commands mastered |",
        "| --- | --- | --- | --- | --- | --- |",
        *(row(name, card["evaluations"][name]) for name in ROWS if name in card["evaluations"]),
        row("tracking", short).replace("| 10 s", "| after five minutes of training: 10 s", 1),
        "",
        f"{_origin(card['run'])} [{LONG}]({LONG}) holds the policy and all of its figures, the test range included. "
        f"Five minutes: {_origin(short['run'])} They buy a robot that mostly stays up and "
        "begins to follow speeds; turning takes half an hour. What was tried on the way: "
        "[docs/lessons.md](docs/lessons.md).",
    ]
    return "\n".join(lines)


def _origin(run: dict[str, Any]) -> str:
    return (
        f"`{run['command']}`: {run['frames']:,} robot steps from scratch in {run['minutes']:.0f} minutes on "
        f"{cores(run['hardware'])}, seed {run['seed']}."
    )


def _read(path: str) -> Any:
    return json.loads((ROOT / path).read_text(encoding="utf-8"))


def main() -> None:
    """Replace what stands between the markers."""
    readme = ROOT / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    readme.write_text(f"{before}{BEGIN}\n{section()}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Generator of the README's results from ``results/``: ``python scripts/readme_results.py``, at the root of a clone."""

from __future__ import annotations

import json
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # benchmarks/ is not installed

from benchmarks.default_recipe import FIGURES, spread  # noqa: E402
from torchrl_atr.training.provenance import cores  # noqa: E402

BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
SEEDS, LONGEST = "results/default_recipe", "results/a1-single_board"


def section() -> str:
    """Return the results as Markdown: a clip, a table, and a line of provenance for each column."""
    report = json.loads((ROOT / SEEDS / "default_recipe.json").read_text(encoding="utf-8"))
    longest = json.loads((ROOT / LONGEST / "metrics.json").read_text(encoding="utf-8"))
    runs = report["runs"]
    lines = [
        "## Results",
        "",
        f"![a ride]({LONGEST}/ride.gif)",
        "",
        f"| A1, single board, deployed | default recipe, {len(runs)} seeds: median (range) | longest run, one seed "
        "| a board that never moves |",
        "| --- | --- | --- | --- |",
    ]
    for name, (label, style) in FIGURES.items():
        still = "-" if name == "survival" else style.format(longest["do_nothing"][name])  # by definition, nobody falls
        lines.append(f"| {label} | {spread(runs, name)} | {style.format(longest[name])} | {still} |")
    minutes = sorted(run["run"]["minutes"] for run in runs)
    first = runs[0]["run"]
    lines += [
        "",
        f"Default recipe: `{report['command']}`, {first['frames']:,} robot steps each, in {minutes[0]:.0f} to "
        f"{minutes[-1]:.0f} minutes on {cores(first['hardware'])} ([{SEEDS}]({SEEDS})). Longest run: five in a row, "
        f"each from the one before, 133 minutes in all, on two cores; [{LONGEST}]({LONGEST}) holds it and its "
        f"commands. All: {longest['n']} robots, 10 s from rest, intrinsics of the training range, |c_v| <= 2 m/s, "
        "|c_ω| <= 1 rad/s.",
    ]
    return "\n".join(lines)


def main() -> None:
    """Replace the text between the markers."""
    readme = ROOT / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    readme.write_text(f"{before}{BEGIN}\n{section()}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()

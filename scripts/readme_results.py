"""Writes the README's results from the run folders under ``results/``: ``python scripts/readme_results.py``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torchrl_atr.training.provenance import cores

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
ROWS = (
    ("robots still up after 10 s", "survival", "{:.1%}"),
    ("settled speed error, straight, m/s", "settled_speed_error_straight", "{:.3f}"),
    ("settled speed error, all commands, m/s", "settled_speed_error", "{:.3f}"),
    ("settled yaw rate error, rad/s", "settled_yaw_error", "{:.3f}"),
    ("slope of yaw rate on its command", "yaw_slope", "{:.3f}"),
)


def section(folder: Path) -> str:
    """One run as Markdown: a clip, a table, and where the numbers come from."""
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    run, still, path = metrics["run"], metrics["do_nothing"], folder.relative_to(ROOT)
    lines = ["## Results", "", f"![a ride]({path}/ride.gif)", ""]
    lines += ["| deployed policy | ours | a board that never moves |", "| --- | --- | --- |"]
    for label, key, style in ROWS:
        theirs = None if key == "survival" else still[key]  # nobody falls off by definition: that is no achievement
        values = ("-" if v is None else style.format(v) for v in (metrics[key], theirs))
        lines.append(f"| {label} | {' | '.join(values)} |")
    lines += [
        "",
        f"{origin(run)}, then `torchrl-atr evaluate`: {metrics['n']} robots, 10 s from rest, fresh intrinsics of the "
        f"training range, proprioception only. Everything is in [{path}]({path}).",
    ]
    return "\n".join(lines)


def origin(run: dict[str, Any]) -> str:
    """What a run came from, the runs that it began from first."""
    before = f"{origin(run['from'])}; then " if "from" in run else ""
    own = f"{run['frames']:,} robot steps in {run['minutes']:.0f} minutes on {cores(run['hardware'])}"
    return f"{before}`{run['command']}`: {own}"


def main() -> None:
    """Replaces what stands between the markers."""
    readme = ROOT / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    sections = "\n\n".join(section(path.parent) for path in sorted(ROOT.glob("results/*/metrics.json")))
    readme.write_text(f"{before}{BEGIN}\n{sections}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()

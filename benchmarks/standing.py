"""Survival of each robot on each transporter under zero action: ``python -m benchmarks.standing``.

Drive on, command zero. Measured with the trunk's centre of mass centred, in the full training range, and there with
pushes; in the robots' own stance and in a wider, longer one; for the large robots, on Table II's springs
as printed, too (question A12).
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict

from benchmarks import results
from torchrl_atr._files import say
from torchrl_atr.envs import ROBOTS, RidingEnv, get_interpretation, get_transporter
from torchrl_atr.envs.models import TRANSPORTER_DESIGNS
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.runs.provenance import machine

STANCE = (0.15, 0.1, 0.0)
"""Wider, longer and lower, as shares of the standing height."""
CONDITIONS = ((True, False), (False, False), (False, True))
"""Centred centre of mass, and pushes, of each column of the table."""
_CASE = ("robot", "transporter", "scaled_springs", "wide", "centred", "pushed")


@torch.no_grad()
def survival(
    robot: str,
    transporter: str,
    *,
    centred: bool,
    pushed: bool = False,
    wide: bool = False,
    scaled_springs: bool = True,
    robots: int = 512,
    seconds: float = 5.0,
    seed: int = 0,
    num_threads: int | None = None,
) -> float:
    """Measure the share of robots still up after ``seconds`` of zero action.

    Args:
        robot: name of the robot.
        transporter: name of the transporter.
        centred: whether the trunk's CoM shift is zero instead of drawn; all else is in its training range.
        pushed: whether robots and transporters are pushed, every 3 s.
        wide: whether robots stand in :data:`STANCE` instead of in their own q0.
        scaled_springs: field of that name of ``Interpretation`` (question A12); false: springs as in Table II.
        robots: number of robots.
        seconds: of standing.
        seed: of intrinsic parameters and initial states.
        num_threads: of the physics.
    """
    interpretation = get_interpretation("default", scaled_springs=scaled_springs)
    env = RidingEnv(
        robot,
        transporter,
        robots,
        profile=interpretation,
        pushes=pushed,
        stance=STANCE if wide else None,
        seed=seed,
        num_threads=num_threads,
    )
    if centred:
        state = env.get_state()
        x_int = state["x_int"].clone()
        x_int[:, env.runner.intrinsics.slices["com_shift"]] = 0.0  # the middle of a range about zero
        env.set_state(state.set("x_int", x_int))
    stand = TensorDict({"action": torch.zeros(env.action_spec.shape)}, [robots])
    up = torch.ones(robots, dtype=torch.bool)
    for _ in range(round(seconds / CONTROL_DT)):
        up &= ~env.step(stand)["next", "terminated"].squeeze(-1)
    env.close(raise_if_closed=False)
    return float(up.float().mean())


def cases() -> Iterator[dict[str, Any]]:
    """Yield the measured cases: every pair in both stances, the large robots on both kinds of springs."""
    for robot, transporter in itertools.product(ROBOTS.names(), TRANSPORTER_DESIGNS):
        for scaled in (True, False) if ROBOTS.get(robot).group == "G2" else (True,):
            for wide, (centred, pushed) in itertools.product((False, True), CONDITIONS):
                yield {
                    "robot": robot,
                    "transporter": transporter,
                    "scaled_springs": scaled,
                    "wide": wide,
                    "centred": centred,
                    "pushed": pushed,
                }


def table(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    found = {tuple(row[name] for name in _CASE): row["survival"] for row in report["survival"]}
    wider, longer, lower = STANCE
    lines = [
        "# Standing without acting",
        "",
        results.origin(report),
        "",
        f"Share of {report['robots']} robots (seed {report['seed']}) that are still up after {report['seconds']:g} s "
        "of zero action, command zero, drive on, intrinsics of Table II's training range: with the trunk's centre of "
        "mass centred and everything else drawn; with everything drawn (centre of mass ±20 cm); and with pushes every "
        f"3 s, too. The wide stance (setting `task.stance`) has the feet {wider:.0%} of the standing height "
        f"further out and {longer:.0%} further apart along x, and the trunk {lower:.0%} lower. The springs of the "
        "large (G2) transporters are five times Table II's by default, two and a half times on each of two boards "
        "(question A12, field `scaled_springs`).",
        "",
        "| robot | transporter | springs | stance | CoM centred | full range | full range, pushes |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for robot, transporter, scaled, wide in dict.fromkeys(key[:4] for key in found):
        scale = get_transporter(transporter, ROBOTS.get(robot)).spring_scale if scaled else 1.0
        springs = "as printed" if scale == 1.0 else f"{scale:g} times"
        shares = (f"{found[robot, transporter, scaled, wide, *condition]:.1%}" for condition in CONDITIONS)
        stance = "wide" if wide else "own"
        lines.append(f"| {robot} | {transporter} | {springs} | {stance} | {' | '.join(shares)} |")
    return "\n".join([*lines, ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Measure all cases and write ``standing.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.standing", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/standing"), metavar="FOLDER")
    parser.add_argument("--robots", type=int, default=512)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    setup = {"robots": arguments.robots, "seconds": arguments.seconds, "seed": arguments.seed}
    started, rows = time.monotonic(), []
    for case in cases():
        rows.append({**case, "survival": survival(**case, **setup)})
        say(", ".join(f"{name} {value}" for name, value in rows[-1].items()))
    report = {
        "command": "python -m benchmarks.standing" + "".join(f" --{name} {value:g}" for name, value in setup.items()),
        **setup,
        "wall_seconds": round(time.monotonic() - started, 1),
        "survival": rows,
        **machine(),
    }
    results.write(arguments.output, "standing", report, table(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())

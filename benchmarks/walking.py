"""Walking policies, the legged baseline: trained from scratch, measured over a minute and by gait, packed as bundles.

``python -m benchmarks.walking`` continues where it was stopped, and ``--robots`` splits the work. The report is of all
robots that are done.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import step_mdp

from benchmarks import results
from torchrl_atr._files import say
from torchrl_atr.deploy.card import read_report
from torchrl_atr.deploy.manifest import is_bundle
from torchrl_atr.envs import ROBOTS
from torchrl_atr.envs.models import get_robot
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks.state import GRAVITY
from torchrl_atr.envs.tasks.walking import MAX_SPEED
from torchrl_atr.evaluation import evaluate_tracking, tracking_metrics
from torchrl_atr.evaluation.access import deterministic
from torchrl_atr.evaluation.intervals import share_text, wilson
from torchrl_atr.runs.provenance import cores, machine
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, TrainConfig, load_run, make_config, make_env

SECONDS, SETTLE = 60.0, 5.0
"""Length of a trial, and the time at its start that the settled figures leave out, s."""
SPEEDS, YAW_RATES = (0.0, 1 / 3, 2 / 3, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Commanded speeds as shares of the largest one, and yaw rates, rad/s."""
COPIES = 12
"""Robots per command."""
GAIT_SECONDS, GAIT_ROBOTS = 20.0, 32
PUBLISHED = (
    "Published costs of transport: ANYmal 0.42 (0.45 m/s on moss) to 1.2 (vegetation), of positive mechanical power; "
    "MIT Cheetah 0.5 and Raibo2 0.25, of all power."
)
SCORECARD = "scorecard"
"""Name of the file in the run's folder: the card of a bundle has its figures."""


def evaluate(run: Path) -> dict[str, Any]:
    """Evaluate a run: figures of the deployed policy over commands, by range of intrinsics, and of its gait."""
    config, env, networks, state = load_run(run, num_envs=1)
    env.close()
    policy = networks.deployed_policy()
    tracking = {randomization: _tracking(policy, config, randomization) for randomization in ("train", "test")}
    gait = [measure_gait(policy, config, speed) for speed in _speeds(config)[1:]]
    return {"evaluations": tracking, "gait": gait, "run": state["provenance"]}


def _speeds(config: TrainConfig) -> tuple[float, ...]:
    top = MAX_SPEED[get_robot(config.task.robot).group]
    return tuple(share * top for share in SPEEDS)


def _tracking(policy: TensorDictModuleBase, config: TrainConfig, randomization: str) -> dict[str, Any]:
    result = evaluate_tracking(
        policy,
        partial(make_env, config, randomization=randomization, **DEPLOYMENT_OVERRIDES),
        (_speeds(config), YAW_RATES),
        COPIES,
        SECONDS,
        SETTLE,
        seed=config.seed + 1,
    )
    metrics = tracking_metrics(result)
    names = ("n", "survival", "survival_interval", "settled_speed_error", "settled_yaw_error", "yaw_slope")
    worst = {f"worst_{name}": float(np.nanmean(getattr(result, name), -1).max()) for name in names[3:5]}
    return {**{name: metrics.get(name) for name in names}, **worst}


def measure_gait(policy: TensorDictModuleBase, config: TrainConfig, speed: float) -> dict[str, float]:
    """Measure robots that walk straight ahead: cost of transport, duty factor, air time, swing height.

    Args:
        policy: deployed policy.
        config: of its run.
        speed: commanded, m/s.

    Returns:
        Means over robots and time after the first five seconds: ``speed``, m/s; ``power``, Σ max(τ q̇, 0), W;
        ``cost_of_transport``, power over m g v; ``duty``, share of time that a foot has contact; ``swing_height``,
        highest point of a foot in a stride, m; ``air_time``, s.
    """
    env = make_env(config, num_envs=GAIT_ROBOTS, seed=config.seed + 2, **DEPLOYMENT_OVERRIDES)
    env.curriculum.pin((speed, 0.0))
    base, samples = env.base_env, []
    with deterministic(policy):
        td = env.reset()
        for step in range(round(GAIT_SECONDS / CONTROL_DT)):
            td = env.step(td.update(policy(td.select(*policy.in_keys))))
            if step * CONTROL_DT >= SETTLE:
                state = base.runner.terms.extractor.read()
                power = (state.torque * state.torque_velocity).clamp_min(0.0).sum(-1)
                samples.append(
                    torch.cat([td["next", "speeds"][:, :1], power[:, None], state.contacts, state.foot_height], -1)
                )
            td = step_mdp(td)
    speeds, power, contacts, heights = torch.stack(samples).split([1, 1, 4, 4], -1)
    mass = base.engine.fields["body_mass"].sum(-1).float()
    env.close(raise_if_closed=False)
    reached = speeds.mean(0)[:, 0]
    return {
        "command": speed,
        "speed": float(reached.mean()),
        "power": float(power.mean()),
        "cost_of_transport": float((power.mean(0)[:, 0] / (mass * GRAVITY * reached)).mean()),
        "duty": float(contacts.mean()),
        **strides(contacts > 0, heights),
    }


def strides(bears: Tensor, heights: Tensor) -> dict[str, float]:
    """Compute mean air time, s, and height, m, of complete swings.

    Args:
        bears: contact of each foot, (T, N, 4) bool.
        heights: of each foot, m, (T, N, 4).

    Example:
        >>> bears = torch.tensor([True, False, False, True])[:, None, None]
        >>> figures = strides(bears, torch.tensor([0.0, 0.01, 0.03, 0.0])[:, None, None])
        >>> {name: round(value, 2) for name, value in figures.items()}
        {'air_time': 0.04, 'swing_height': 0.03}
    """
    times, peaks = [], []
    for foot, height in zip(bears.flatten(1).T.numpy(), heights.flatten(1).T.numpy()):
        edges = np.diff(foot.astype(int))
        lifts, lands = np.flatnonzero(edges == -1) + 1, np.flatnonzero(edges == 1) + 1
        for lift in lifts:
            after = lands[lands > lift]
            if len(after):
                times.append((after[0] - lift) * CONTROL_DT)
                peaks.append(float(height[lift : after[0]].max()))
    if not times:
        return {"air_time": 0.0, "swing_height": 0.0}
    return {"air_time": float(np.mean(times)), "swing_height": float(np.mean(peaks))}


def page(report: Mapping[str, Any]) -> str:
    """Return the report as Markdown."""
    lines = [
        "# Walking policies",
        "",
        f"`{report['command']}`. Deployed, with realistic sensors: proprioception only. {SECONDS:g} s from rest "
        "without pushes, speeds from 0 to 1.5 m/s (A1, Go1) or 3 m/s (ANYmal-C, Spot), yaw rates "
        f"{min(YAW_RATES):g} to {max(YAW_RATES):g} rad/s; errors after {SETTLE:g} s.",
        "",
        "| robot | minutes | robot steps | intrinsics | robots | up at the end | speed error, m/s (worst command) | "
        "yaw error, rad/s (worst command) |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for robot, found in report["robots"].items():
        origin = found["run"]
        for name, row in found["evaluations"].items():
            errors = " | ".join(
                f"{row[f'settled_{kind}_error']:.3f} ({row[f'worst_settled_{kind}_error']:.3f})"
                for kind in ("speed", "yaw")
            )
            interval = row.get("survival_interval") or wilson(round(row["survival"] * row["n"]), row["n"])
            cells = [robot, f"{origin['minutes']:.0f}", f"{origin['frames']:,}", f"{name} range", str(row["n"])]
            lines.append(f"| {' | '.join([*cells, share_text(row['survival'], interval), errors])} |")
    lines += [
        "",
        f"The gait, straight on, {GAIT_ROBOTS} robots; power is Σ max(τ q̇, 0), its cost of transport P / (m g v). "
        f"{PUBLISHED}",
        "",
        "| robot | command, m/s | reached, m/s | power, W | cost of transport | duty factor | air time, s | "
        "swing height, m |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for robot, found in report["robots"].items():
        for row in found["gait"]:
            lines.append(
                f"| {robot} | {row['command']:g} | {row['speed']:.2f} | {row['power']:.1f} | "
                f"{row['cost_of_transport']:.2f} | {row['duty']:.2f} | {row['air_time']:.2f} | "
                f"{row['swing_height']:.3f} |"
            )
    machines = sorted({cores(found["run"]["hardware"]) for found in report["robots"].values()})
    return "\n".join([*lines, "", f"Trained on {'; '.join(machines)}.", ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Train, measure and pack; write ``walking.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.walking", description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=tuple(ROBOTS.names()), default=tuple(ROBOTS.names()))
    parser.add_argument("--frames", type=int, default=5_000_000, help="robot steps")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, default=Path("results/walking"), metavar="FOLDER")
    parser.add_argument("--runs", type=Path, default=Path("runs/walking"), metavar="FOLDER", help="to continue")
    parser.add_argument("--policies", type=Path, default=Path("torchrl_atr/policies"), metavar="FOLDER")
    return results.exit_code("walking", partial(_all, parser.parse_args(argv)))


def _all(arguments: argparse.Namespace) -> None:
    configs = {robot: _config(robot, arguments) for robot in arguments.robots}
    for robot, config in configs.items():
        results.refuse_other_settings(config, arguments.runs / robot, ("compute", "max_minutes"))
    command = f"python -m benchmarks.walking --frames {arguments.frames} --seed {arguments.seed}"
    for robot, config in configs.items():
        run, bundle = arguments.runs / robot, arguments.policies / f"{robot}-walking"
        if read_report(run / f"{SCORECARD}.json") is None:
            results.train(config, run)
            found = evaluate(run)
            results.write(run, SCORECARD, found, page({"command": command, "robots": {robot: found}}))
        if not is_bundle(bundle):
            results.call("export", run, "--output", bundle)
        cards = {name: read_report(arguments.runs / name / f"{SCORECARD}.json") for name in ROBOTS.names()}
        done = {name: card for name, card in cards.items() if card is not None}
        report = {"command": command, "robots": done, "versions": machine()["versions"]}
        results.write(arguments.output, "walking", report, page(report))
    say(page(report))


def _config(robot: str, arguments: argparse.Namespace) -> TrainConfig:
    settings = {
        "task.robot": robot,
        "task.sensors": "realistic",
        "seed": arguments.seed,
        "total_frames": arguments.frames,
        "max_minutes": 60.0,
    }
    return make_config({"task.name": "walking", **settings, "compute.compiled": True})


if __name__ == "__main__":
    sys.exit(main())

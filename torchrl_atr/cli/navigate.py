"""``torchrl-atr navigate``: trips over a map along planned paths."""

from __future__ import annotations

import argparse
import dataclasses
import math
from functools import partial
from typing import Any

from torchrl_atr._files import folder_for, say, whole
from torchrl_atr.cli.chosen import checkpoint_file
from torchrl_atr.cli.option_types import file_path, number_in, run_folder, seed
from torchrl_atr.cli.printing import step_progress
from torchrl_atr.deploy.manifest import report_home

_LINES = (
    ("success", "share at the goal"),
    ("spl", "success weighted by path length"),
    ("seconds", "duration, s"),
    ("speed", "mean speed, m/s"),
    ("deviation", "mean distance to the path, m"),
    ("cot_paper", "cost of transport, mean over joints (the paper's)"),
    ("cot_joints", "cost of transport, sum over joints"),
    ("cot_system", "cost of transport, joints and transporter"),
)


def add_navigate(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``navigate`` to its parser."""
    parser.add_argument("run", type=run_folder)
    parser.add_argument("--map", default="open", help="open, streets, a .toml file or an image; default: open")
    parser.add_argument("--resolution", type=number_in(float, 1e-3, 100), default=0.1, help="of an image, m per pixel")
    parser.add_argument("--goal", type=number_in(float, -1e6, 1e6), nargs=2, metavar=("X", "Y"), help="default: drawn")
    parser.add_argument("--starts", type=number_in(int, 1, 10_000), default=50, help="number of trips; default: 50")
    parser.add_argument("--speed", type=number_in(float, 0.1, 100), default=1.5, help="m/s; default: 1.5")
    text = "rad/s of a turn; the paths' turning radius is speed over this; default: 0.5"
    parser.add_argument("--yaw-rate", type=number_in(float, 0.01, 100), default=0.5, help=text)
    text = "rad/s, the largest command, which a board follows only in part; default: 1, or the policy's largest if less"
    parser.add_argument("--max-yaw-rate", type=number_in(float, 0.01, 100), help=text)
    parser.add_argument("--margin", type=number_in(float, 0, 100), default=0.8, help="to obstacles, m; default: 0.8")
    text = "seconds that a commanded yaw rate takes to come; default: 2 for riding, 0 for other tasks"
    parser.add_argument("--response", type=number_in(float, 0, 100), help=text)
    parser.add_argument("--seed", type=seed, default=0)
    parser.add_argument("--sensors", metavar="NAME", help="default: the run's")
    parser.add_argument(
        "--output", type=file_path, help="default: RUN/navigation/MAP, of a bundle runs/policies/NAME/navigation/MAP"
    )


def navigate(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr navigate``."""
    from torchrl_atr._cpus import available_cpus
    from torchrl_atr.navigation import PursuitConfig, load_map, plan_all, run_trips
    from torchrl_atr.navigation.places import draw_places
    from torchrl_atr.navigation.pursuit import RESPONSES
    from torchrl_atr.navigation.report import trip_metrics, write_trips
    from torchrl_atr.navigation.trips import check_commands, footprint_of
    from torchrl_atr.training import DEPLOYMENT_OVERRIDES, load_run, make_env
    from torchrl_atr.training.loading import commanded_range

    where = load_map(arguments.map, arguments.resolution)
    output = arguments.output or report_home(arguments.run) / "navigation" / where.name
    chosen = {**DEPLOYMENT_OVERRIDES, **({} if arguments.sensors is None else {"sensors": arguments.sensors})}
    config, env, networks, state = load_run(
        arguments.run, checkpoint_file(arguments), arguments.imports or (), num_envs=1, **chosen
    )
    limits, footprint = commanded_range(config, networks), footprint_of(env)
    response = RESPONSES.get(config.task.name, 0.0) if arguments.response is None else arguments.response
    most = arguments.max_yaw_rate or min(
        PursuitConfig.max_yaw_rate, math.inf if limits is None else limits.max_yaw_rate
    )
    pursuit = PursuitConfig(arguments.speed, most, response=response)
    check_commands(env, pursuit, limits)  # before paths are planned
    env.close()
    radius = arguments.speed / arguments.yaw_rate
    starts, goal = draw_places(where, arguments.starts, footprint, arguments.margin, arguments.goal, arguments.seed)
    with folder_for(output):
        say(f"planning {len(starts)} paths on {where.name!r} to ({goal[0]:.1f}, {goal[1]:.1f})")
        asked = {"goal": goal, "turning_radius": radius, "footprint": footprint, "margin": arguments.margin}
        paths = plan_all(starts, available_cpus(), arguments.seed + 1, where=where, **asked)
        with step_progress("riding") as progress:
            make = partial(make_env, config, **chosen)
            result = run_trips(
                networks.deployed_policy(), make, paths, where, pursuit, seed=arguments.seed, progress=progress
            )
        metrics = trip_metrics(result)
        asked |= {"map": where.name, "pursuit": dataclasses.asdict(pursuit), "seed": arguments.seed}
        asked |= {"sensors": arguments.sensors or config.task.sensors}
        with whole(output) as folder:
            write_trips(result, paths, where, {**metrics, "asked": asked, "run": state["provenance"]}, folder)
    say("\n".join([*_report(metrics), f"report in {output}"]))


def _report(metrics: dict[str, Any]) -> list[str]:
    outcomes = ", ".join(f"{name} {count}" for name, count in metrics["outcomes"].items())
    lines = [f"{metrics['trips']} trips: {outcomes}"]
    for name, label in _LINES:
        value = metrics[name]
        mean, interval = (value, metrics[f"{name}_interval"]) if name == "success" else value.values()
        if mean is not None:
            within = "" if interval is None else f" [{interval[0]:.3f}, {interval[1]:.3f}]"
            lines.append(f"{label}: {mean:.3f}{within}")
    return lines

"""How ``evaluate`` measures: the protocols, and which options each has."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from torchrl_atr.cli.printing import endurance_lines, estimator_lines, headlines

if TYPE_CHECKING:
    from torchrl_atr.envs.transforms import CommandGrid
    from torchrl_atr.modules import RidingNetworks
    from torchrl_atr.training import TrainConfig

ONLY = {
    "tracking": ("speed_step", "yaw_rate_step", "robots_per_command"),
    "endurance": ("seconds", "command_seconds", "pushes", "robots"),
}
"""Options that one protocol alone has; None where they are not given."""
Progress = Callable[[int, int], None]


class Measured(NamedTuple):
    """What a protocol measured: the metrics, what writes the report into a folder, and the lines to print."""

    metrics: dict[str, Any]
    write: Callable[[Path], Any]
    lines: list[str]


def check_options(arguments: argparse.Namespace) -> None:
    """Refuse options of another protocol than the chosen one.

    Raises:
        ConfigError: names them.
    """
    from torchrl_atr.cli.parser import option
    from torchrl_atr.training import ConfigError

    for protocol, names in ONLY.items():
        given = [option(name) for name in names if getattr(arguments, name) is not None]
        if given and protocol != arguments.protocol:
            raise ConfigError(f"{', '.join(given)}: only of --protocol {protocol}; leave it out, or take that protocol")


def tracking(
    arguments: argparse.Namespace,
    config: TrainConfig,
    networks: RidingNetworks,
    make_env: Callable[..., Any],
    progress: Progress,
) -> Measured:
    """Measure how every command of a grid is tracked, 10 s from rest without pushes."""
    from torchrl_atr.evaluation import evaluate_tracking, tracking_metrics, write_report

    result = evaluate_tracking(
        networks.rollout_policy(arguments.act_source),
        make_env,
        _grid(arguments, config.make_task().command.grid),
        robots_per_command=arguments.robots_per_command or 8,
        seed=arguments.seed,
        encoder_module=networks.encoder_module,
        progress=progress,
    )
    metrics = tracking_metrics(result)
    lines = [*headlines(metrics), *estimator_lines(metrics["estimator_errors"])]
    return Measured(metrics, partial(write_report, result, metrics), lines)


def endurance(
    arguments: argparse.Namespace,
    config: TrainConfig,
    networks: RidingNetworks,
    make_env: Callable[..., Any],
    progress: Progress,
) -> Measured:
    """Measure how long robots stay up under changing commands and pushes, and how well they track meanwhile."""
    from torchrl_atr.evaluation import endurance_metrics, evaluate_endurance, write_endurance

    given = {name: getattr(arguments, name) for name in ("robots", "seconds", "command_seconds")}
    result = evaluate_endurance(
        networks.rollout_policy(arguments.act_source),
        partial(make_env, pushes=arguments.pushes is not False),
        **{name: value for name, value in given.items() if value is not None},
        max_speed=arguments.max_speed,
        max_yaw_rate=arguments.max_yaw_rate,
        seed=arguments.seed,
        overspeed=(config.runaway_speed, config.runaway_yaw_rate),
        encoder_module=networks.encoder_module,
        progress=progress,
    )
    metrics = endurance_metrics(result)
    return Measured(metrics, partial(write_endurance, result, metrics), list(endurance_lines(metrics)))


def _grid(arguments: argparse.Namespace, grid: CommandGrid | None) -> tuple[Any, Any]:
    """Return the speeds and yaw rates to evaluate, within those of the task."""
    from torchrl_atr.evaluation import command_grid

    largest = 2.0 if grid is None else min(2.0, grid.bounds[0])
    speed = largest if arguments.max_speed is None else arguments.max_speed
    yaw_rate = 1.0 if arguments.max_yaw_rate is None else arguments.max_yaw_rate
    step = (1.0 if float(speed).is_integer() else 0.5) if arguments.speed_step is None else arguments.speed_step
    speeds, yaw_rates = command_grid(speed, yaw_rate, step, arguments.yaw_rate_step or 0.25)
    return (speeds[speeds >= 0] if grid is not None and grid.forward_only else speeds), yaw_rates


PROTOCOLS: dict[str, Callable[..., Measured]] = {"tracking": tracking, "endurance": endurance}
"""By the name that ``--protocol`` takes."""

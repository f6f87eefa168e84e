"""Protocols of ``evaluate``, and the options of each."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from torchrl_atr.cli.measured import Measured
from torchrl_atr.cli.option_types import option_name
from torchrl_atr.cli.printing import endurance_lines, estimator_lines, headlines
from torchrl_atr.cli.sweeps import SHORT_RIDE, compatibility, robustness

if TYPE_CHECKING:
    from torchrl_atr.envs.transforms import CommandGrid
    from torchrl_atr.modules import ROANetworks
    from torchrl_atr.training import TrainConfig

Progress = Callable[[int, int], None]


class Protocol(NamedTuple):
    """Protocol of a measurement.

    Attributes:
        measure: function that carries it out.
        options: its options by name, with their defaults; None for a default that depends on the task.
    """

    measure: Callable[..., Measured]
    options: dict[str, Any]


def fill_options(arguments: argparse.Namespace) -> None:
    """Set options of the chosen protocol that are not given to their defaults, and refuse those of others.

    Raises:
        ConfigError: names the options that the protocol does not have.
    """
    from torchrl_atr.training import ConfigError

    if arguments.command_range == "record" and arguments.protocol != "tracking":
        raise ConfigError("--command-range record: commands are found mastered one by one; take --protocol tracking")
    if arguments.protocol == "compatibility":
        for name in ("robot", "transporter"):
            if getattr(arguments, name) is not None:
                raise ConfigError(f"--{name}: --protocol compatibility takes pairs; give --on ROBOT/TRANSPORTER")
    own = PROTOCOLS[arguments.protocol].options
    known = dict.fromkeys(name for protocol in PROTOCOLS.values() for name in protocol.options)
    for name in known:
        if name not in own and getattr(arguments, name) is not None:
            owners = " or ".join(f"--protocol {each}" for each, other in PROTOCOLS.items() if name in other.options)
            raise ConfigError(f"{option_name(name)}: only of {owners}; leave it out, or take that protocol")
    for name, value in own.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)
    _check_conditions(arguments)


def _check_conditions(arguments: argparse.Namespace) -> None:
    from torchrl_atr.training import ConfigError

    if arguments.command_range == "record":
        deployed = {"act_source": "estimated", "sensors": None, "randomization": "train", "checkpoint": "last"}
        for name, value in deployed.items():
            if (chosen := getattr(arguments, name)) != value:
                raise ConfigError(
                    "--command-range record: the range is that of the deployed policy in training conditions; leave "
                    f"out {option_name(name)} {chosen}"
                )
    if arguments.protocol == "robustness" and arguments.randomization != "train":
        raise ConfigError(
            f"--randomization {arguments.randomization}: --protocol robustness begins with the training range; leave "
            "it out"
        )


def tracking(
    arguments: argparse.Namespace,
    config: TrainConfig,
    networks: ROANetworks,
    make_env: Callable[..., Any],
    progress: Progress,
) -> Measured:
    """Measure the tracking of every command of a grid, 10 s from rest without pushes."""
    from torchrl_atr.evaluation import evaluate_tracking, tracking_metrics, write_report

    result = evaluate_tracking(
        networks.deployed_policy(arguments.act_source),
        make_env,
        _grid(arguments, config.make_task().command.grid),
        robots_per_command=arguments.robots_per_command,
        seed=arguments.seed,
        encoder_module=networks.encoder_module,
        progress=progress,
    )
    metrics = tracking_metrics(result)
    lines = [*headlines(metrics), *estimator_lines(metrics["estimator_errors"])]
    return Measured(result, metrics, partial(write_report, result, metrics), lines)


def endurance(
    arguments: argparse.Namespace,
    config: TrainConfig,
    networks: ROANetworks,
    make_env: Callable[..., Any],
    progress: Progress,
) -> Measured:
    """Measure how long robots stay up under changing commands and pushes, and how well they track meanwhile."""
    from torchrl_atr.evaluation import endurance_metrics, evaluate_endurance, write_endurance
    from torchrl_atr.evaluation.endurance import overspeed_of

    result = evaluate_endurance(
        networks.deployed_policy(arguments.act_source),
        partial(make_env, pushes=arguments.pushes),
        robots=arguments.robots,
        seconds=arguments.seconds,
        command_seconds=arguments.command_seconds,
        max_speed=arguments.max_speed,
        max_yaw_rate=arguments.max_yaw_rate,
        seed=arguments.seed,
        overspeed=overspeed_of(config.env.overspeed_margin),
        encoder_module=networks.encoder_module,
        progress=progress,
    )
    metrics = endurance_metrics(result)
    return Measured(result, metrics, partial(write_endurance, result, metrics), list(endurance_lines(metrics)))


def _grid(arguments: argparse.Namespace, grid: CommandGrid | None) -> tuple[Any, Any]:
    """Return the speeds and yaw rates to evaluate, within those of the task."""
    from torchrl_atr.evaluation import command_grid

    largest = 2.0 if grid is None else min(2.0, grid.bounds[0])
    speed = largest if arguments.max_speed is None else arguments.max_speed
    step = (1.0 if float(speed).is_integer() else 0.5) if arguments.speed_step is None else arguments.speed_step
    speeds, yaw_rates = command_grid(speed, arguments.max_yaw_rate, step, arguments.yaw_rate_step)
    return (speeds[speeds >= 0] if grid is not None and grid.forward_only else speeds), yaw_rates


_TRACKING = {
    "randomization": "train",
    "max_speed": None,
    "max_yaw_rate": 1.0,
    "speed_step": None,
    "yaw_rate_step": 0.25,
    "robots_per_command": 8,
}
_PAPER = {
    "randomization": "test",
    "max_speed": 15.0,
    "max_yaw_rate": 2.0,
    "speed_step": 0.1,
    "yaw_rate_step": 0.1,
    "robots_per_command": 1,
}
_ENDURANCE = {
    "randomization": "train",
    "max_speed": None,
    "max_yaw_rate": None,
    "robots": 200,
    "seconds": 60.0,
    "command_seconds": 5.0,
    "pushes": True,
}
PROTOCOLS: dict[str, Protocol] = {
    "tracking": Protocol(tracking, _TRACKING),
    "paper": Protocol(tracking, _PAPER),
    "endurance": Protocol(endurance, _ENDURANCE),
    "robustness": Protocol(robustness, {**SHORT_RIDE, "parameters": None}),
    "compatibility": Protocol(compatibility, {**SHORT_RIDE, "on": None}),
}
"""Protocols by the name that ``--protocol`` takes. ``paper`` is the paper's evaluation: one robot of the test range at
each of 12,341 commands, 10 s from rest."""

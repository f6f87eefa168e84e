"""What the settings of a run must fulfil, alone and together, beyond their kinds."""

from __future__ import annotations

from inspect import signature
from typing import TYPE_CHECKING

import torch

from torchrl_atr._errors import UserError
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks import TASKS
from torchrl_atr.modules import SOURCES
from torchrl_atr.training.ranges import RANGES

if TYPE_CHECKING:
    from torchrl_atr.training.config import TrainConfig

COLLECTORS = ("direct", "process", "ray", "distributed")
"""Engines that collect batches."""
LOGGERS = ("csv", "tensorboard", "wandb", "mlflow")
"""Loggers of a run's metrics."""


class ConfigError(UserError, ValueError):
    """A configuration that names something unknown or holds an impossible value."""


def check_settings(config: TrainConfig) -> None:
    """Check the values of all settings.

    Args:
        config: whose settings are of the right kinds, and whose modules have been imported.

    Raises:
        ConfigError: for a value that is unknown, out of range, or does not go with another; names both and the remedy.
        UnknownNameError: for an unknown task, robot, transporter or profile.
    """
    for name, (low, high) in RANGES.items():
        value = getattr(config, name)
        if not low <= value <= high:  # nor is a NaN
            raise ConfigError(f"{name}={value!r} is out of range; choose a number in [{low:.10g}, {high:.10g}]")
    config.make_task()
    _check_transporter(config)
    _check_networks(config)
    _check_times(config)
    _check_processes(config)
    _check_device(config.device)
    _check_schedules(config)
    _check_grid(config)


def _check_transporter(config: TrainConfig) -> None:
    if (
        config.transporter != type(config).transporter
        and "transporter" not in signature(TASKS.get(config.task)).parameters
    ):
        raise ConfigError(
            f"transporter={config.transporter!r}: the task {config.task!r} has no transporter; leave it out, or take "
            "task=riding"
        )


def _check_networks(config: TrainConfig) -> None:
    cells = config.critic_cells
    if not cells or min(cells) < 1:
        raise ConfigError(f"critic_cells={cells} must be widths of 1 or more, such as 256,128,64")
    if config.symmetric and any(width % 2 for width in cells):
        raise ConfigError(f"critic_cells={cells} must be even, half for each side; or symmetric=false")
    if config.act_source not in SOURCES:
        raise ConfigError(f"act_source={config.act_source!r} is unknown; choose one of {', '.join(SOURCES)}")


def _check_times(config: TrainConfig) -> None:
    if config.score_from_seconds > config.command_seconds - CONTROL_DT:
        raise ConfigError(
            f"score_from_seconds={config.score_from_seconds:g} must be below "
            f"command_seconds={config.command_seconds:g} by a control step: nothing would be left to score"
        )
    if config.episode_seconds < config.command_seconds:
        raise ConfigError(
            f"episode_seconds={config.episode_seconds:g} must be at least command_seconds={config.command_seconds:g}: "
            "no command would ever be scored"
        )


def _check_processes(config: TrainConfig) -> None:
    if config.collector not in COLLECTORS:
        raise ConfigError(f"collector={config.collector!r} is unknown; choose one of {', '.join(COLLECTORS)}")
    if config.logger not in LOGGERS:
        raise ConfigError(f"logger={config.logger!r} is unknown; choose one of {', '.join(LOGGERS)}")
    if config.collector != "direct" and config.num_envs % config.workers:
        raise ConfigError(
            f"num_envs={config.num_envs} cannot be shared evenly by workers={config.workers}; choose a multiple of it"
        )


def _check_device(name: str) -> None:
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ConfigError(f"device={name!r} is unknown; use 'cpu' or 'cuda'") from error
    if device.type not in ("cpu", "cuda"):
        raise ConfigError(f"device={name!r} is not supported; use 'cpu' or 'cuda'")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        found = torch.cuda.device_count() or "no"
        raise ConfigError(f"device={name!r}: torch finds {found} CUDA device here; use 'cpu'")


def _check_schedules(config: TrainConfig) -> None:
    if config.learning_rate > config.max_learning_rate:
        raise ConfigError(
            f"learning_rate={config.learning_rate:g} must not exceed max_learning_rate={config.max_learning_rate:g}, "
            "up to which it is adapted"
        )
    if config.anneal_from >= config.anneal_until:
        raise ConfigError(
            f"anneal_until={config.anneal_until:g} must be larger than anneal_from={config.anneal_from:g}; both are "
            "shares of the run"
        )
    for name in ("init_std", "relative_std", "final_std"):
        if config.min_std >= getattr(config, name):
            raise ConfigError(f"min_std={config.min_std:g} must be below {name}={getattr(config, name):g}")


def _check_grid(config: TrainConfig) -> None:
    try:
        _ = config.grid
    except ValueError as error:
        names = ("initial_speed", "initial_yaw_rate", "max_speed", "max_yaw_rate")
        given = ", ".join(f"{name}={getattr(config, name):g}" for name in names)
        raise ConfigError(f"{given}: {error}") from error

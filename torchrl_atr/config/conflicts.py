"""Conflicts between the settings of a run: what each message says goes wrong, and the remedy."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from typing import TYPE_CHECKING

import torch

from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks import Task
from torchrl_atr.envs.tasks.riding.foot_steps import PLACE_COMPONENTS

if TYPE_CHECKING:
    from torchrl_atr.config.train_config import TrainConfig

_ORDER = (
    ("curriculum.command_seconds", "env.episode_seconds", 0.0, "no command would ever be scored"),
    ("curriculum.score_from_seconds", "curriculum.command_seconds", CONTROL_DT, "nothing would be left to score"),
    ("ppo.learning_rate", "ppo.max_learning_rate", 0.0, "the rate is adapted up to that"),
    ("exploration.anneal_from", "exploration.anneal_until", 1e-9, "both are shares of the run"),
    ("env.episodes_grow_from", "env.episodes_grow_until", 0, "both are shares of the run"),
    *(
        ("exploration.min_std", f"exploration.{name}_std", 1e-9, "it is the floor")
        for name in ("init", "relative", "final")
    ),
)
"""Settings that may not exceed others, by how much they must be below them, and why."""
_READ = {
    "ppo.tracking_errors": ("extrinsic",),
    "estimator.dead_reckoning": ("extrinsic",),
    "estimator.shared": ("latent", "extrinsic"),
    "env.reposition_feet": ("extrinsic",),
}
"""Settings that need estimates, and which of the actor's inputs these are."""


def conflicts(config: TrainConfig, task: Task) -> Iterator[str]:
    """Yield a message for each conflict between settings, or between settings and the task, with the remedy."""
    yield from _orders(config)
    yield from _widths(config)
    yield from _estimates(config)
    yield from _pairs(config)
    yield from _workers(config)
    yield from _foot_steps(config, task)
    yield from _device(config.compute.device)
    yield from _grid(config, task)


def _orders(config: TrainConfig) -> Iterator[str]:
    for low, high, gap, why in _ORDER:
        one, other = operator.attrgetter(low, high)(config)
        if one > other - gap:
            yield f"{low}={one:g} must {'be below' if gap else 'not exceed'} {high}={other:g}: {why}"


def _widths(config: TrainConfig) -> Iterator[str]:
    for path in ("ppo.actor_cells", "ppo.critic_cells", "roa.encoder_cells", "roa.latent_features"):
        value = operator.attrgetter(path)(config)
        cells = list(value) if isinstance(value, tuple) else value  # as files hold them
        if not cells:
            yield f"{path}=() must be widths of 1 or more, such as 256,128,64"
        if config.ppo.symmetric and any(width % 2 for width in (cells if isinstance(cells, list) else [cells])):
            yield f"{path}={cells} must be even, half for each side; or ppo.symmetric=false"


def _estimates(config: TrainConfig) -> Iterator[str]:
    reads = config.roa.actor_reads
    for path, needed in _READ.items():
        value = operator.attrgetter(path)(config)
        if value and (missing := [name for name in needed if name not in reads]):
            on, off = ("true", "false") if value is True else (f"{value:g}", "0")
            yield (
                f"{path}={on} needs an estimate that the actor does not read: roa.actor_reads="
                f"{','.join(reads) or 'none'} lacks {' and '.join(missing)}; add it there, or set {path}={off}"
            )


def _pairs(config: TrainConfig) -> Iterator[str]:
    for path, units in {"env.overspeed_margin": "m/s and rad/s", "curriculum.slew_rates": "m/s² and rad/s²"}.items():
        if len(given := operator.attrgetter(path)(config)) not in (0, 2):
            yield f"{path}={given}: give two numbers, {units}, or none"


def _workers(config: TrainConfig) -> Iterator[str]:
    num_envs, workers = config.env.num_envs, config.compute.workers
    if config.compute.collector != "direct" and num_envs % workers:
        yield f"env.num_envs={num_envs} cannot be shared evenly by compute.workers={workers}; choose a multiple of it"


def _foot_steps(config: TrainConfig, task: Task) -> Iterator[str]:
    known = task.observations.get(("privileged", "extrinsic"), {})
    if config.env.reposition_feet and (missing := [name for name in PLACE_COMPONENTS if name not in known]):
        yield (
            f"env.reposition_feet={config.env.reposition_feet:g} needs {' and '.join(missing)} in the extrinsic state, "
            f"which the task {task.name!r} does not have as it is set; set env.reposition_feet=0"
        )


def _device(name: str) -> Iterator[str]:
    try:
        device = torch.device(name)
    except RuntimeError:
        device = torch.device("meta")
    if device.type not in ("cpu", "cuda"):
        yield f"compute.device={name!r} is unknown; use 'cpu' or 'cuda'"
    elif device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        yield f"compute.device={name!r}: torch finds {torch.cuda.device_count() or 'no'} CUDA device here; use 'cpu'"


def _grid(config: TrainConfig, task: Task) -> Iterator[str]:
    own = config.curriculum
    try:
        own.bound(task.command.grid)
    except ValueError as error:
        names = ("initial_speed", "initial_yaw_rate", "max_speed", "max_yaw_rate")
        yield f"curriculum: {', '.join(f'{name}={getattr(own, name):g}' for name in names)}: {error}"

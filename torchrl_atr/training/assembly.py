"""Construction of the env, networks, loss and schedules of a run from its configuration."""

from __future__ import annotations

import dataclasses
import inspect
import operator
from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictSequential
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase, TransformedEnv

from torchrl_atr import envs
from torchrl_atr._compilation import compile_methods
from torchrl_atr._registry import import_modules
from torchrl_atr.config import ConfigError, ExplorationConfig, TrainConfig
from torchrl_atr.envs.models.identity import PARTS
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks import TASKS
from torchrl_atr.envs.tasks.support_tilt import PITCH
from torchrl_atr.envs.transforms import CommandGrid, TimeLimitGrowth
from torchrl_atr.modules import (
    Exploration,
    NetworkKeys,
    ROANetworks,
    hadamard_leg_basis,
    make_networks,
    with_correlated_noise,
)
from torchrl_atr.modules.action_noise import RotatedNormal
from torchrl_atr.modules.checks import check_registered
from torchrl_atr.modules.estimators import state_keys
from torchrl_atr.modules.sizes import estimator_specs
from torchrl_atr.objectives import DistillationLoss, ROAClipPPOLoss
from torchrl_atr.training.env_access import attribute

TIME_LIMIT_CHECK_INTERVAL = 10
"""Interval in control steps at which time limits are checked, a divisor of the default recipe's 1000."""
LOADING_OVERRIDES: dict[str, Any] = {
    "compiled": False,
    "stagger": 0,
    "time_limit_growth": None,
    "compact_storage": False,
}
"""Env arguments of a run that is loaded, not trained: there may be no compiler."""
TASK_OVERRIDES: dict[str, Any] = {"moving_start": 0.0, "displaced_start": 0.0, "pushes": False}
"""Arguments of a task's function that turn off what belongs to training only."""
DEPLOYMENT_OVERRIDES: dict[str, Any] = {
    **LOADING_OVERRIDES,
    **TASK_OVERRIDES,
    "overspeed_margin": None,
    "max_steps": 2**31 - 1,
    "failed_episode_replay": 0.0,
    "grid": None,
}
"""Env arguments that turn off what belongs to training only: a ride from rest at any command that only a fall ends."""


def make_env(config: TrainConfig, **overrides: Any) -> TransformedEnv:
    """Return the env that a configuration describes.

    Args:
        config: of a run.
        **overrides: arguments of :func:`torchrl_atr.envs.make_env`, or of the task's function, to replace; those of
            :data:`DEPLOYMENT_OVERRIDES` that the task does not have are left out, and ``grid=None`` is the task's grid
            with the run's bounds where those are wider.

    Raises:
        ConfigError: for a robot, a transporter or sensors that the task does not have.
    """
    import_modules(config.imports)  # another process has checked a config that was sent to this one
    of_the_task = inspect.signature(TASKS.get(config.task.name)).parameters
    task = {name: overrides.pop(name) for name in list(overrides) if name in of_the_task}
    for part in (*PARTS, "sensors"):
        if part in overrides:
            raise ConfigError(f"{part}={overrides[part]!r}: the task {config.task.name!r} has no {part}; leave it out")
    trained = config.grid
    arguments: dict[str, Any] = {
        "num_envs": config.env.num_envs,
        "num_threads": config.compute.num_threads or None,
        "seed": config.seed,
        "compiled": config.compute.compiled,
        "failed_episode_replay": config.env.failed_episode_replay,
        "history_length": config.env.history_length,
        "max_steps": round(config.env.episode_seconds / CONTROL_DT),
        "stagger": TIME_LIMIT_CHECK_INTERVAL if config.env.staggered_starts else 0,
        "time_limit_growth": _time_limit_growth(config),
        "window": round(config.curriculum.command_seconds / CONTROL_DT),
        "thresholds": (config.curriculum.tracking_threshold,) * 2,
        "score_from": round(config.curriculum.score_from_seconds / CONTROL_DT),
        "compact_storage": True,
        "command_slew": config.curriculum.slew_rates or None,
        "overspeed_margin": config.env.overspeed_margin or None,
        "reposition_feet": config.env.reposition_feet,
        "grid": trained,
    }
    arguments |= {name: value for name, value in overrides.items() if name not in TASK_OVERRIDES}
    made = config.make_task(**task)
    if arguments["grid"] is None:
        arguments["grid"] = _widened(made.command.grid, trained)
    return envs.make_env(made, **arguments)


def _time_limit_growth(config: TrainConfig) -> TimeLimitGrowth | None:
    first, steps = config.env.first_episode_seconds, config.total_frames / config.env.num_envs
    if not 0 < first < config.env.episode_seconds or not config.env.staggered_starts:
        return None
    begin, end = round(config.env.episodes_grow_from * steps), round(config.env.episodes_grow_until * steps)
    return TimeLimitGrowth(max(1, round(first / CONTROL_DT)), begin, end, config.env.short_episodes)


def _widened(grid: CommandGrid | None, other: CommandGrid | None) -> CommandGrid | None:
    """Return a grid with the bounds of another of the same bins where those are wider."""
    if grid is None or other is None:
        return grid
    speed, yaw_rate = (max(pair) for pair in zip(grid.bounds, other.bounds, strict=True))
    return dataclasses.replace(grid, bounds=(speed, yaw_rate))


def make_run_networks(config: TrainConfig, env: TransformedEnv) -> ROANetworks:
    """Return the networks that a configuration describes, sized by the env's specs.

    Raises:
        UnknownNameError: for an unregistered estimator.
        EstimatorError: if it cannot be built.
        ConfigError: if a setting asks for an entry that the env does not have.
    """
    spec = env.observation_spec
    products, errors = _command_inputs(config, env)
    exploration, output_map = _exploration(config.exploration, env.action_spec.shape[-1])
    networks = make_networks(
        spec,
        env.action_spec,
        estimator=config.estimator.name,
        estimator_kwargs=config.estimator.arguments,
        estimator_inputs=_estimator_inputs(config, spec),
        shared_estimator=config.estimator.shared,
        actor_reads=config.roa.actor_reads,
        actor_reads_scale=config.estimator.actor_reads_scale,
        input_products=products,
        input_errors=errors,
        latent_features=config.roa.latent_features,
        encoder_cells=config.roa.encoder_cells,
        output_map=output_map,
        exploration=exploration,
        actor_cells=config.ppo.actor_cells,
        critic_cells=config.ppo.critic_cells,
        privileged_critic=config.ppo.privileged_critic,
        critic_inputs=_input(config, "ppo.tracking_forecast", NetworkKeys.tracking_forecast, spec)
        if config.ppo.privileged_critic
        else [],
        reflections=env.base_env.reflections if config.ppo.symmetric else None,
    )
    untrained = config.estimator.epochs == 0 and config.roa.act_source == "privileged"
    networks.is_teacher = untrained and bool(networks.estimator_modules)
    return networks


def _command_inputs(config: TrainConfig, env: TransformedEnv) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return the products and the errors that the actor reads, see :class:`~torchrl_atr.modules.ActorBackbone`."""
    size = env.observation_spec["observation"].shape[-1]  # the command is the end of o_t
    speed, yaw_rate = size - 2, size - 1
    followed = env.base_env.followed if config.ppo.tracking_errors else ()
    errors = list(zip((speed, yaw_rate), followed))
    gates = [speed] if config.ppo.command_interaction else []
    observed = env.base_env.runner.terms.observations.names("proprio")
    if gates and PITCH in observed:
        gates.append(observed.index(PITCH))
    turns = [yaw_rate] + [size + 1] * bool(errors)
    return [(gate, turn) for gate in gates for turn in turns], errors


def _exploration(config: ExplorationConfig, actions: int) -> tuple[Exploration, Tensor | None]:
    """Return the exploration, and the map from the actor's outputs to its directions; None for joint by joint."""
    if not config.leg_patterns:
        return Exploration(actions, config.init_std, config.min_std), None
    basis = hadamard_leg_basis()
    alike = len(basis) // 4
    init_std = [config.init_std] * alike + [config.relative_std] * (len(basis) - alike)
    return Exploration(len(basis), init_std, config.min_std, basis), _output_map(init_std, basis)


def _output_map(init_std: Sequence[float], basis: Tensor) -> Tensor:
    """Return the (A, A) matrix that maps each output of the actor to one direction of exploration, with a gain.

    Adam's steps are alike in all outputs. In units of the exploration's initial variance, a direction's share of the
    divergence follows its exploration: a direction that is explored little does not use up the trust region.
    """
    std = torch.as_tensor(init_std, dtype=basis.dtype)
    return (std.square() / std.max()).unsqueeze(-1) * basis.T


def check_run_estimator(config: TrainConfig, env: TransformedEnv) -> None:
    """Check a configuration's estimator with the sizes of the run, in a fraction of a second.

    Raises:
        UnknownNameError: for an unregistered estimator.
        EstimatorError: if it cannot be trained or deployed; names it and the property that fails.
        ConfigError: see :func:`make_run_networks`.
    """
    spec = env.observation_spec
    specs = estimator_specs(
        spec,
        config.roa.latent_features,
        estimator_inputs=_estimator_inputs(config, spec),
        shared=config.estimator.shared,
        actor_reads=config.roa.actor_reads,
    )
    check_registered(config.estimator.name, specs.values(), **config.estimator.arguments)


def _estimator_inputs(config: TrainConfig, spec: Composite) -> list[NestedKey]:
    return _input(config, "estimator.dead_reckoning", NetworkKeys.dead_reckoned_velocity, spec)


def _input(config: TrainConfig, setting: str, key: NestedKey, spec: Composite) -> list[NestedKey]:
    """Return the entry that a setting makes a network read, if it does; ConfigError if the env has no such entry."""
    if not operator.attrgetter(setting)(config):
        return []
    if key not in spec.keys(True, True):
        raise ConfigError(
            f"{setting}=true reads {key!r}, which the env does not have; set it to false, or observe {key!r}"
        )
    return [key]


def make_run_loss(
    config: TrainConfig, networks: ROANetworks, loss_class: type[ROAClipPPOLoss] | None = None, **more: Any
) -> ROAClipPPOLoss:
    """Return the loss that a configuration describes.

    Args:
        config: of a run.
        networks: that it trains.
        loss_class: a subclass of :class:`~torchrl_atr.objectives.ROAClipPPOLoss` to make instead of it, or of
            :class:`~torchrl_atr.objectives.DistillationLoss` for imitation.
        **more: further arguments of it.

    Example:
        >>> from functools import partial
        >>> class MyLoss(ROAClipPPOLoss):
        ...     pass
        >>> make_loss = partial(make_run_loss, TrainConfig(), loss_class=MyLoss)  # for Trainer
    """
    arguments: dict[str, Any] = {
        "roa_coeff": config.roa.coeff,
        "smoothness_coeff": config.ppo.smoothness_coeff,
        "extrinsic_scale": networks.ext_norm if config.estimator.normalize_targets else None,
        "clip_epsilon": config.ppo.clip_epsilon,
        "entropy_coeff": config.ppo.entropy_coeff,
        "entropy_bonus": True,
        "critic_coeff": 1.0 / networks.critic.scale**2,
        "loss_critic_type": "l2",
        "normalize_advantage": False,
        "functional": False,
    }
    made = loss_class or (DistillationLoss if config.roa.policy_update == "imitation" else ROAClipPPOLoss)
    loss = made(
        networks.training_actor(config.roa.act_source),
        networks.critic_module,
        networks.encoder_module,
        networks.intrinsic_estimator_module,
        networks.extrinsic_estimator_module,
        **{**arguments, **more},
    )
    if (keys := getattr(networks, "keys", None)) is not None:
        loss.set_keys(**keys.for_loss())
    return loss


def make_reward_schedule(env: EnvBase) -> dict[str, Callable[[float], float]]:
    """Return the factors of the reward terms of the env's task over a run: functions of its progress in [0, 1]."""
    return dict(getattr(attribute(env, "task"), "reward_schedule", {}))


def make_policy(config: TrainConfig, networks: ROANetworks) -> TensorDictSequential:
    """Return the policy that a run collects with; it shares the networks.

    ``exploration.noise_correlation`` is of our Gaussian policy: custom networks with another distribution sample from
    that.
    """
    actor = networks.rollout_policy(config.roa.act_source)
    direct = config.compute.collector == "direct"  # compiled modules cannot be sent to workers
    if config.compiles_networks and direct and not state_keys(actor):  # TorchRL's recurrent modules ask for values
        compile_methods(actor.module[0], "forward")
    if getattr(actor.module[-1], "distribution_class", None) is not RotatedNormal:
        return actor
    return with_correlated_noise(actor, config.exploration.noise_correlation)

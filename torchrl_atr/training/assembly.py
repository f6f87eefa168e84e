"""From a configuration to its env and networks, and from a run folder back to both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictSequential
from torch import Tensor
from torchrl.envs import TransformedEnv

from torchrl_atr._compilation import compile_methods
from torchrl_atr._registry import import_modules
from torchrl_atr.envs import make_riding_env
from torchrl_atr.envs.models.identity import PARTS
from torchrl_atr.envs.task.state import CONTROL_DT
from torchrl_atr.modules import (
    EstimatorError,
    Exploration,
    NetworkKeys,
    RidingNetworks,
    correlate,
    leg_synergies,
    make_networks,
)
from torchrl_atr.modules.checks import check_registered
from torchrl_atr.modules.sizes import estimator_sizes
from torchrl_atr.training.checkpoint import CheckpointError, load_checkpoint
from torchrl_atr.training.config import TrainConfig
from torchrl_atr.training.restoring import check_model, deployed_weights, load_networks, run_config

TOGETHER = 10
"""Time limits are looked at in every so many steps, a divisor of the default recipe's 250."""
_TO_LOOK_AT: dict[str, Any] = {"compiled": False, "stagger": 0, "stored_once": False}
"""Env arguments of a run that is loaded where there may be no compiler, and is not trained on."""
DEPLOYED: dict[str, Any] = {
    **_TO_LOOK_AT,
    "moving_start": 0.0,
    "pushes": False,
    "runaway_margin": None,
    "max_steps": 2**31 - 1,
    "retry": 0.0,
    "grid": None,
}
"""Env arguments without what belongs to training only: a ride from rest, at any command, that only a fall ends."""


def make_env(config: TrainConfig, **overrides: Any) -> TransformedEnv:
    """The env that a configuration describes.

    Args:
        config: of a run.
        **overrides: arguments of :func:`torchrl_atr.envs.make_riding_env` to replace.
    """
    import_modules(config.imports)  # a config that was sent to another process was checked in the first alone
    arguments: dict[str, Any] = {
        "robot": config.robot,
        "transporter": config.transporter,
        "num_envs": config.num_envs,
        "profile": config.profile,
        "num_threads": config.num_threads or None,
        "seed": config.seed,
        "compiled": config.compiled,
        "moving_start": config.moving_start,
        "retry": config.retry,
        "history_length": config.history_length,
        "max_steps": round(config.episode_seconds / CONTROL_DT),
        "stagger": TOGETHER,
        "window": round(config.command_seconds / CONTROL_DT),
        "thresholds": (config.tracking_threshold,) * 2,
        "score_from": round(config.score_from_seconds / CONTROL_DT),
        "stored_once": True,
        "runaway_margin": (config.runaway_speed, config.runaway_yaw_rate),
        "grid": config.grid,
    }
    return make_riding_env(**{**arguments, **overrides})


def make_run_networks(config: TrainConfig, env: TransformedEnv) -> RidingNetworks:
    """The networks that a configuration describes, sized by the env's specs.

    Raises:
        UnknownNameError: for an unregistered estimator.
        EstimatorError: if it cannot be built.
    """
    basis, keys = leg_synergies(), NetworkKeys()
    alike, joints = len(basis) // 4, len(basis)
    init_std = [config.init_std] * alike + [config.relative_std] * (joints - alike)
    size = env.observation_spec["observation"].shape[-1]  # the command ends o_t
    return make_networks(
        env.observation_spec,
        env.action_spec,
        estimator=config.estimator,
        estimator_inputs=_estimator_inputs(config),
        products=[(size - 2, size - 1)] if config.steering_cue else [],
        output_map=_output_map(init_std, basis),
        exploration=Exploration(joints, init_std, config.min_std, basis),
        critic_cells=config.critic_cells,
        privileged_critic=config.privileged_critic,
        critic_inputs=[keys.outlook] if config.privileged_critic and config.tracking_forecast else [],
        reflections=env.base_env.reflections if config.symmetric else None,
        keys=keys,
    )


def _output_map(init_std: Sequence[float], basis: Tensor) -> Tensor:
    """Return what makes each output of the actor move one direction of exploration, with a gain, (A, A).

    Adam's steps are alike in all outputs. In units of the exploration's initial variance, a direction's share of the
    divergence follows what its exploration can teach: what is explored little does not use up the trust region.
    """
    std = torch.as_tensor(init_std, dtype=basis.dtype)
    return (std.square() / std.max()).unsqueeze(-1) * basis.T


def check_run_estimator(config: TrainConfig, env: TransformedEnv) -> None:
    """Check a configuration's estimator in the sizes that the run has, in a fraction of a second.

    Raises:
        UnknownNameError: for an unregistered estimator.
        EstimatorError: if it cannot be trained or deployed; names it and the property that fails.
    """
    sizes = estimator_sizes(env.observation_spec, estimator_inputs=_estimator_inputs(config))
    check_registered(config.estimator, sizes.values())


def _estimator_inputs(config: TrainConfig) -> list[NestedKey]:
    return [NetworkKeys().odometry] if config.dead_reckoning else []


def make_policy(config: TrainConfig, networks: RidingNetworks) -> TensorDictSequential:
    """The policy that a run collects with; it shares the networks."""
    actor = networks.rollout_policy(config.act_source, config.student_fraction)
    if config.compiles_networks and config.collector == "direct":  # what is compiled cannot be sent to workers
        compile_methods(actor.module[0], "forward")
    return correlate(actor, config.noise_correlation)


def load_run(
    run: str | Path, checkpoint: str | None = None, imports: Sequence[str] = (), **env_overrides: Any
) -> tuple[TrainConfig, TransformedEnv, RidingNetworks, dict[str, Any]]:
    """Config, env, networks as they are deployed, in eval mode, and the whole checkpoint of a run folder.

    Args:
        run: the folder.
        checkpoint: a file in it, such as ``best.pt``; None for the last one.
        imports: modules to import besides those that the run remembers; with some, the latter may be missing.
        **env_overrides: see :func:`make_env`; a ``robot`` or ``transporter`` is taken in the place of the run's own.

    Raises:
        CheckpointError: if there is no readable checkpoint, it does not fit this code, or robot or transporter are not
            those that the run was trained with.
    """
    run = Path(run)
    if checkpoint is not None and not (run / checkpoint).is_file():
        raise CheckpointError(f"{run} has no {checkpoint}; train for longer, or take the last checkpoint")
    state = load_checkpoint(run if checkpoint is None else run / checkpoint)
    config = run_config(state, run, imports, device="cpu")  # wherever it was trained
    env = make_env(config, **{**_TO_LOOK_AT, **env_overrides})
    replaced = [part for part in PARTS if part in env_overrides]
    own = env
    if replaced:  # networks keep the symmetry of what they were trained on, wherever they ride
        own = make_env(config, num_envs=1, **_TO_LOOK_AT)
    check_model(state, own.base_env.scene, run, replaced)
    try:
        networks = make_run_networks(config, own)
    except EstimatorError as error:
        raise CheckpointError(f"the estimator {config.estimator!r} of {run} does not work here: {error}") from error
    load_networks(networks, deployed_weights(state["learner"]), run)
    return config, env, networks.eval(), state

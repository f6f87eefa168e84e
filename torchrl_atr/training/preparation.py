"""Preparation of a run: checks and construction before its folder is written to, and initial normalisers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torchrl.envs import EnvBase

from torchrl_atr.envs.models.identity import Description, describe
from torchrl_atr.training.config import ConfigError, TrainConfig
from torchrl_atr.training.env_access import attribute
from torchrl_atr.training.loggers import check_logger
from torchrl_atr.training.parts import FACTORIES, Parts
from torchrl_atr.training.restoring import check_model, deployed_weights, load_networks, other_parts, read_other


def check_given(
    config: TrainConfig, run: Path, parts: Parts, state: Mapping[str, Any] | None, start: Path | None, logger: Any
) -> dict[str, Any] | None:
    """Check the arguments of a trainer before they are used.

    Args:
        config: of the run.
        run: its folder.
        parts: custom parts.
        state: the checkpoint that it continues from, if any.
        start: folder of the run that it begins from, if any.
        logger: a custom logger, if any.

    Returns:
        The checkpoint in ``start``, and that folder as ``run``.

    Raises:
        CheckpointError: if a checkpoint lacks something, or parts that were its run's own are not given.
        ConfigError: if a part or the logger cannot be used, or both runs are one.
    """
    if not isinstance(config, TrainConfig):
        raise ConfigError(f"config={config!r}; give a TrainConfig, such as make_config({{'num_envs': 512}})")
    if state is not None and not isinstance(state, Mapping):
        raise ConfigError(f"state={state!r}; give what load_checkpoint(run) returns")
    parts.check(config)
    missing = [name for name in ("log_metrics", "log_hparams") if not hasattr(logger, name)]
    if logger is not None and missing:
        raise ConfigError(f"logger={logger!r} lacks {missing[0]}; give one of torchrl.record.loggers")
    if logger is None:
        check_logger(config.logging.logger)
    if state is not None:
        parts.check_complete(state, run, FACTORIES)
        if state.get("members"):
            raise ConfigError(f"{run} was trained by several learners, which are gone; begin a new run with --from")
    if start is None:
        return None
    other = read_other(start, run)
    parts.check_complete(other, start, ["make_networks"])
    return other


def trained_networks(
    config: TrainConfig,
    run: Path,
    env: EnvBase,
    parts: Parts,
    state: Mapping[str, Any] | None,
    other: Mapping[str, Any] | None,
    replaced: Iterable[str],
) -> Any:
    """Return a run's networks on the learner's device, with the weights of either checkpoint.

    Args:
        config: of the run.
        run: its folder, for messages.
        env: of the run.
        parts: of the run.
        state: the checkpoint that it continues from, if any.
        other: of the run that it begins from, if any, from :func:`check_given`.
        replaced: parts of the robot's model that may be another than in ``other`` though they are called the same.

    Raises:
        CheckpointError: if a checkpoint is of another model, or of other networks.
        ConfigError: if the networks lack something.
        EstimatorError: if the estimator cannot be trained.
    """
    scene = attribute(env, "scene")
    if state is not None:
        check_model(state, scene, run)
    elif other is not None:
        check_model(other, scene, Path(other["run"]), {*replaced, *other_parts(config, other)})
    networks = parts.networks(config, env)
    if state is not None:
        load_networks(networks, state["learner"]["networks"], run)
    elif other is not None:
        load_networks(networks, deployed_weights(other["learner"]), Path(other["run"]))
    return networks.to(config.compute.device)


def model_of(env: EnvBase) -> Description | None:
    """Return the description of the env's robot and transporter for checkpoints; None for an env without them."""
    scene = attribute(env, "scene")
    return None if scene is None else describe(scene)


@torch.no_grad()
def init_normalizers(networks: Any, env: EnvBase, steps: int, device: str) -> None:
    """Initialise normalisers with means and scales under random actions.

    It replaces ``ObservationNorm.init_stats`` of TorchRL's transforms, whose numbers stay with the env; these are
    deployed with the networks. A step at a time: a rollout would hold every history.

    Args:
        networks: whose normalisers they are.
        env: in which so many steps are taken.
        steps: control steps.
        device: of the networks.
    """
    carrier, key, spec = env.reset(), env.action_key, env.action_spec
    for _ in range(steps):
        carrier[key] = torch.randn(spec.shape, dtype=spec.dtype)  # whatever the bounds
        step, carrier = env.step_and_maybe_reset(carrier)
        networks.update_normalizers(step.to(device))

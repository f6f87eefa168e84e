"""Preparation of a run: checks and construction before its folder is written to, and initial normalisers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torchrl.envs import EnvBase

from torchrl_atr.config import ConfigError, TrainConfig
from torchrl_atr.runs.restoring import check_model, deployed_weights, load_networks, other_parts, read_other
from torchrl_atr.training.env_access import attribute
from torchrl_atr.training.loggers import check_logger
from torchrl_atr.training.parts import FACTORIES, Parts


def check_given(
    config: TrainConfig, run: Path, parts: Parts, state: Mapping[str, Any] | None, start: Path | None, logger: Any
) -> dict[str, Any] | None:
    """Check the arguments of a trainer; return the checkpoint of the run that it begins from, if any.

    Raises:
        CheckpointError: if a checkpoint lacks something, or parts that were its run's own are not given.
        ConfigError: if a part or the logger cannot be used, both runs are one, or a student has no teacher.
    """
    if not isinstance(config, TrainConfig):
        raise ConfigError(f"config={config!r}; give a TrainConfig, such as make_config({{'num_envs': 512}})")
    if state is not None and not isinstance(state, Mapping):
        raise ConfigError(f"state={state!r}; give what load_checkpoint(run) returns")
    parts.check(config)
    check_logger(config.logging.logger, logger)
    if state is not None:
        parts.check_complete(state, run, FACTORIES)
        if state.get("members"):
            raise ConfigError(f"{run} was trained by several learners, which are gone; begin a new run with --from")
    if start is None and state is None and config.roa.policy_update != "ppo":
        raise ConfigError(
            f"roa.policy_update={config.roa.policy_update!r} needs a trained policy: train one with --preset teacher, "
            "and begin from it with --from RUN (begin_from=)"
        )
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
    """Return a run's networks on the learner's device.

    Their weights are those in ``state``, which the run continues from, else the deployed ones in ``other``, which it
    begins from with another robot or transporter if ``replaced`` says so, else new.

    Raises:
        CheckpointError: if a checkpoint is of another model, or of other networks.
        ConfigError: if the networks lack something, or explore more than the settings ask for in the end.
        EstimatorError: if the estimator cannot be trained.
    """
    weights = None
    if state is not None:
        check_model(state, attribute(env, "scene"), run)
        weights = state["learner"]["networks"]
    elif other is not None:
        run = Path(other["run"])
        check_model(other, attribute(env, "scene"), run, {*replaced, *other_parts(config, other)})
        weights = deployed_weights(other["learner"])
    networks = parts.networks(config, env)
    _check_annealing(networks, config)
    if weights is not None:
        load_networks(networks, weights, run)
    return networks.to(config.compute.device)


def _check_annealing(networks: Any, config: TrainConfig) -> None:
    explore, floor = config.exploration, getattr(networks.exploration, "min_std", 0.0)
    if explore.anneal and config.roa.policy_update == "ppo" and explore.final_std <= floor:
        raise ConfigError(
            f"exploration.final_std={explore.final_std:g} must be above the floor of the networks' exploration, "
            f"{floor:g}; give a larger one, a lower floor, or exploration.anneal=false"
        )


@torch.no_grad()
def init_normalizers(networks: Any, env: EnvBase, steps: int, device: str) -> None:
    """Initialise normalisers with means and scales under random actions, in so many control steps.

    It replaces ``ObservationNorm.init_stats`` of TorchRL's transforms, whose numbers stay with the env; these are
    deployed with the networks. A step at a time: a rollout would hold every history.
    """
    carrier, key, spec = env.reset(), env.action_key, env.action_spec
    for _ in range(steps):
        carrier[key] = torch.randn(spec.shape, dtype=spec.dtype)  # whatever the bounds
        step, carrier = env.step_and_maybe_reset(carrier)
        networks.update_normalizers(step.to(device))

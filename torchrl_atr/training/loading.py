"""Loading of a run folder: its configuration, env and networks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from torchrl.envs import EnvBase

from torchrl_atr.config import TrainConfig
from torchrl_atr.deploy.manifest import find_policy, is_bundle
from torchrl_atr.envs.models.identity import PARTS
from torchrl_atr.envs.transforms import CommandGrid
from torchrl_atr.modules import CommandRange, EstimatorError
from torchrl_atr.runs.checkpoint import CheckpointError, load_checkpoint
from torchrl_atr.runs.restoring import check_model, checkpoint_config, deployed_weights, load_networks
from torchrl_atr.training.assembly import LOADING_OVERRIDES, make_env
from torchrl_atr.training.env_access import attribute
from torchrl_atr.training.parts import NetworksFactory, Parts


def load_run(
    run: str | Path,
    checkpoint: str | None = None,
    imports: Sequence[str] = (),
    *,
    make_env: Callable[..., EnvBase] | None = None,
    make_networks: NetworksFactory | None = None,
    **env_overrides: Any,
) -> tuple[TrainConfig, Any, Any, dict[str, Any]]:
    """Return config, env, networks as they are deployed, in eval mode, and the whole checkpoint of a run or a bundle.

    If the folder holds a ``command_range.json``, the networks' deployed policy is clipped to that range.

    Args:
        run: the folder of a run or of a policy bundle, or the name of an installed policy.
        checkpoint: a file in it, such as ``best.pt``; None for the last one.
        imports: modules to import besides those that the run remembers; with some, the latter may be missing.
        make_env: factory of the env, or of one like it, for a run that was trained with a custom env. It is called
            with ``num_envs``, ``seed`` and ``num_threads`` of the run, and with ``env_overrides``.
        make_networks: factory of the networks, for a run that was trained with custom networks.
        **env_overrides: see :func:`~torchrl_atr.training.make_env`; a ``robot`` or ``transporter`` replaces the run's.

    Raises:
        CheckpointError: if there is no readable checkpoint, it does not fit this code, robot or transporter are not
            those that the run was trained with, or it was trained with custom parts that are not given.
        InputError: if ``command_range.json`` holds no range.
        BundleError: if a bundle is incomplete, changed, or of another version.
    """
    run = find_policy(run)
    if checkpoint is not None and is_bundle(run):
        raise CheckpointError(f"{run} is a policy bundle, which has no {checkpoint}; leave out the checkpoint")
    if checkpoint is not None and not (run / checkpoint).is_file():
        raise CheckpointError(f"{run} has no {checkpoint}; train for longer, or take the last checkpoint")
    state = load_checkpoint(run if checkpoint is None else run / checkpoint)
    parts = Parts(make_env, make_networks)
    parts.check_complete(state, run, ("make_env", "make_networks"))
    config = checkpoint_config(state, run, imports, {"compute.device": "cpu"})  # wherever it was trained
    if make_env is None:
        env, trained_in = _recipes_envs(config, state, run, env_overrides)
    else:
        env = trained_in = parts.env_maker(config, run)(**env_overrides)
        check_model(state, attribute(env, "scene"), run, PARTS)
    try:
        networks = parts.networks(config, trained_in)
    except EstimatorError as error:
        raise CheckpointError(
            f"the estimator {config.estimator.name!r} of {run} does not work here: {error}"
        ) from error
    load_networks(networks, deployed_weights(state["learner"]), run)
    networks.command_range = CommandRange.load(run)
    return config, env, networks.eval(), state


def commanded_range(config: TrainConfig, networks: Any) -> CommandRange | None:
    """Return the range of commands that a policy is for: its recorded range, or the box of its training.

    None for a task without a command grid.

    Example:
        >>> from types import SimpleNamespace
        >>> commanded_range(TrainConfig(), SimpleNamespace(command_range=None)).max_speed
        2.2
    """
    if networks.command_range is not None:
        return networks.command_range
    return None if config.grid is None else grid_range(config.grid)


def grid_range(grid: CommandGrid) -> CommandRange:
    """Return the range of all commands of a grid."""
    speed, yaw_rate = grid.bounds
    return CommandRange(speed, yaw_rate, forward_only=grid.forward_only)


def _recipes_envs(
    config: TrainConfig, state: dict[str, Any], run: Path, overrides: dict[str, Any]
) -> tuple[EnvBase, EnvBase]:
    """Return the env that is asked for, and one of the robot that the networks were trained with."""
    env = own = make_env(config, **{**LOADING_OVERRIDES, **overrides})
    replaced = [part for part in PARTS if part in overrides]
    if replaced:  # networks keep the symmetry of the model that they were trained with
        own = make_env(config, num_envs=1, **LOADING_OVERRIDES)
    check_model(state, own.base_env.scene, run, replaced)
    return env, own

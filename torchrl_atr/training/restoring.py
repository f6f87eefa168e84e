"""What a checkpoint must hold, and fit, before a run is built on it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from torchrl_atr._errors import UserError
from torchrl_atr.training.checkpoint import CheckpointError
from torchrl_atr.training.config import TrainConfig
from torchrl_atr.training.config_io import make_config

_PARTS = (
    ("config",),
    ("learner", "networks"),
    ("learner", "optimizers"),
    ("curriculum", "weights"),
    ("frames",),
    ("rng",),
    ("provenance",),
)


def check_parts(state: Mapping[str, Any], run: Path) -> None:
    """Checks that a checkpoint holds what everything that reads a run relies on.

    Args:
        state: from :func:`~torchrl_atr.training.load_checkpoint`.
        run: where it is from, for messages.

    Raises:
        CheckpointError: if a part is missing.
    """
    for path in _PARTS:
        part: Any = state
        for name in path:
            if not isinstance(part, Mapping) or name not in part:
                raise CheckpointError(
                    f"the checkpoint in {run} lacks {'/'.join(path)!r}; give a folder that `torchrl-atr train` wrote"
                )
            part = part[name]


def run_config(state: Mapping[str, Any], run: Path, **changed: Any) -> TrainConfig:
    """The settings of a checkpoint, some of them changed.

    Args:
        state: from :func:`~torchrl_atr.training.load_checkpoint`.
        run: where it is from, for messages.
        **changed: settings to replace.

    Raises:
        CheckpointError: if a part is missing, or a setting does not work with this code or on this machine.
    """
    check_parts(state, run)
    try:
        return make_config({**state["config"], **changed})
    except UserError as error:
        raise CheckpointError(f"the settings of {run} do not work here: {error}") from error


def deployed_weights(learner: Mapping[str, Any]) -> Mapping[str, Any]:
    """The running mean of the weights in a learner's state; the last ones where there was none yet."""
    return learner.get("deployed", learner["networks"])


def load_networks(networks: nn.Module, weights: Mapping[str, Any], run: Path) -> None:
    """Loads trained networks, or says in a line why they do not fit.

    Args:
        networks: made by the settings of that run, or of one that begins from it.
        weights: their ``state_dict`` from the checkpoint.
        run: where it is from, for messages.

    Raises:
        CheckpointError: if names or shapes differ, or a number is not finite.
    """
    here, there = _shapes(networks.state_dict()), _shapes(weights)
    different = [name for name in {**here, **there} if here.get(name) != there.get(name)]
    if different:
        name = different[0]
        raise CheckpointError(
            f"the networks in {run} do not fit these settings: {name} is {there.get(name, 'missing')} in the file and "
            f"{here.get(name, 'missing')} here ({len(different)} differ); use the code, the settings and the estimator "
            "that trained them"
        )
    for name, value in weights.items():
        if isinstance(value, Tensor) and not torch.isfinite(value).all():
            raise CheckpointError(f"the networks in {run} hold a NaN or infinity in {name}; use an earlier checkpoint")
    networks.load_state_dict(dict(weights))


def check_moments(optimizer: torch.optim.Optimizer, saved: Mapping[str, Any], name: str) -> None:
    """Checks the moments in an optimiser's saved state, which a fused step would read and write whatever their shapes.

    Args:
        optimizer: that is to go on with them.
        saved: the ``state_dict`` of another.
        name: of both, for messages.

    Raises:
        CheckpointError: if they are of other parameters.
    """
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    fits = sum(len(group["params"]) for group in saved["param_groups"]) == len(parameters) and all(
        value.ndim == 0 or value.shape == parameters[index].shape
        for index, moments in saved["state"].items()
        for value in moments.values()
    )
    if not fits:
        raise CheckpointError(
            f"the moments of the {name!r} optimiser in the checkpoint are of other parameters than it has here; use "
            "the code, the settings and the estimator that trained them"
        )


def _shapes(weights: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    """By name; what is no tensor, a module's extra state, is not compared."""
    return {name: tuple(value.shape) for name, value in weights.items() if isinstance(value, Tensor)}

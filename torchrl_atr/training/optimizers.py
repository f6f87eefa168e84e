"""Optimisers of a run: one each for policy, critic and estimators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn

from torchrl_atr.config import TrainConfig
from torchrl_atr.runs.restoring import check_moments


def parameter_groups(networks: Any) -> dict[str, list[nn.Parameter]]:
    """Return the parameters that each optimiser trains; without estimators there is no group of them."""
    policy = (networks.encoder, networks.backbone, networks.exploration)
    groups = {
        "policy": [parameter for network in policy if network is not None for parameter in network.parameters()],
        "critic": list(networks.critic.parameters()),
        "estimators": list(networks.estimator_parameters()),
    }
    return {name: group for name, group in groups.items() if group}


def make_optimizers(groups: Mapping[str, list[nn.Parameter]], config: TrainConfig) -> dict[str, torch.optim.Adam]:
    """Return the optimiser of each group."""
    ppo, estimator = config.ppo, config.estimator
    rates = {"policy": ppo.learning_rate, "critic": ppo.critic_learning_rate, "estimators": estimator.learning_rate}
    return {
        name: torch.optim.Adam(group, lr=rates[name], fused=True, capturable=config.captures_graphs)
        for name, group in groups.items()
    }


def load_optimizers(optimizers: Mapping[str, torch.optim.Adam], saved: Mapping[str, Any], config: TrainConfig) -> None:
    """Restore optimisers of a run that continues.

    Raises:
        CheckpointError: if they are of other parameters.
    """
    for name, optimizer in optimizers.items():
        check_moments(optimizer, saved[name], name)
        optimizer.load_state_dict(saved[name])
        for group in optimizer.param_groups:
            group["capturable"] = config.captures_graphs  # as this run needs it, not the saved one


def take_moments(optimizers: Mapping[str, torch.optim.Adam], saved: Mapping[str, Any]) -> None:
    """Take the moments of another run's optimisers, and nothing else of them.

    Raises:
        CheckpointError: if they are of other parameters.
    """
    for name, optimizer in optimizers.items():
        check_moments(optimizer, saved[name], name)
        optimizer.load_state_dict({**optimizer.state_dict(), "state": saved[name]["state"]})

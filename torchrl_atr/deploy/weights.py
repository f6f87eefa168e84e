"""Weights of a bundle, from which TorchRL users load, evaluate and begin runs; a checkpoint without what resumes it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch

from torchrl_atr._errors import MissingPackageError
from torchrl_atr.deploy.manifest import WEIGHTS, BundleError, read_manifest

_KEPT = ("config", "model", "parts", "frames", "provenance")
_CURRICULUM = "curriculum.weights"
_CRITIC = "critic.net."
"""Weights in half precision: no policy reads them, and a run that begins here trains them on."""


def write_weights(folder: Path, state: Mapping[str, Any]) -> None:
    """Write the deployed weights of a checkpoint, by their names in the networks' ``state_dict``, and its settings.

    The critic's are rounded to half precision.

    Args:
        folder: of the bundle.
        state: from :func:`torchrl_atr.training.load_checkpoint`.
    """
    learner, curriculum = state["learner"], state["curriculum"]
    tensors = dict(learner.get("deployed", learner["networks"]))
    rest = {name: state[name] for name in _KEPT if name in state}
    rest["optimizers"] = {name: _groups(each["param_groups"]) for name, each in learner["optimizers"].items()}
    if curriculum is not None:
        tensors[_CURRICULUM], rest["grid"] = curriculum["weights"], curriculum.get("grid")
    owned = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    owned |= {name: value.half() for name, value in owned.items() if name.startswith(_CRITIC)}
    data = _safetensors().save(owned, metadata={"state": json.dumps(rest)})
    (folder / WEIGHTS).write_bytes(data)  # save_file hides the file from other users


def read_weights(folder: Path) -> dict[str, Any]:
    """Return a bundle's state as :func:`torchrl_atr.training.load_checkpoint` returns a run's; optimisers are new.

    Raises:
        BundleError: if the bundle is incomplete, changed, or of another version.
        MissingPackageError: if safetensors is not installed.
    """
    read_manifest(folder)
    try:
        with _safetensors().safe_open(str(folder / WEIGHTS), framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            rest = json.loads(file.metadata()["state"])
    except (KeyError, TypeError, ValueError) as error:
        raise BundleError(f"{folder / WEIGHTS} lacks the run's settings ({error}); export the run anew") from error
    tensors |= {name: value.float() for name, value in tensors.items() if name.startswith(_CRITIC)}
    grid, optimizers = rest.pop("grid", None), rest.pop("optimizers")
    reached = tensors.pop(_CURRICULUM, None)
    moments = {name: {"state": {}, "param_groups": groups} for name, groups in optimizers.items()}
    return {
        **rest,
        "learner": {"networks": tensors, "deployed": tensors, "optimizers": moments},
        "curriculum": None if reached is None else {"weights": reached, "grid": grid},
        "rng": torch.empty(0, dtype=torch.uint8),
    }


def _groups(groups: Any) -> Any:
    """Return an optimiser's groups as JSON holds them: a rate may be a tensor."""
    return json.loads(json.dumps(groups, default=float))


def _safetensors() -> Any:
    try:
        from safetensors import safe_open
        from safetensors import torch as of_torch
    except ImportError:
        raise MissingPackageError("safetensors", "deploy") from None
    return SimpleNamespace(save=of_torch.save, safe_open=safe_open)

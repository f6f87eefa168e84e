"""Checks of a checkpoint before a run is built on it, and loading of its settings and networks.

In every function ``state`` is from :func:`~torchrl_atr.training.load_checkpoint`, and ``run`` is the folder that it is
from, which messages name.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from types import MappingProxyType
from typing import Any

import torch
from torch import Tensor, nn

from torchrl_atr._errors import InputError, UserError, first_line
from torchrl_atr._registry import import_modules
from torchrl_atr.config import ConfigError, TrainConfig, make_config
from torchrl_atr.deploy.manifest import find_policy
from torchrl_atr.envs.models import Scene
from torchrl_atr.envs.models.identity import PARTS, describe, differences, first_few
from torchrl_atr.runs.checkpoint import CheckpointError, load_checkpoint
from torchrl_atr.runs.files import located_settings

_NEEDED = (
    "config",
    "config/task",
    "learner/networks",
    "learner/optimizers",
    "curriculum",
    "frames",
    "rng",
    "provenance",
)
"""Entries of a checkpoint that every reader of a run needs."""

SINCE = {
    "ppo.tracking_errors": False,
    "task.observe_tilt": False,
    "curriculum.slew_rates": (),
    "task.stance": (),
    "task.steadiness": 0.0,
    "task.slip_weight": 0.0,
    "env.reposition_feet": 0.0,
    "task.fall_weight": 1.0,
    "task.interpretation.aligned_com": False,
}
"""Values of settings that were added after a run was made; each keeps what that run did."""


def check_entries(state: Mapping[str, Any], run: Path) -> None:
    """Raise a :class:`CheckpointError` if a checkpoint lacks an entry that every reader of a run needs."""
    for path in _NEEDED:
        part: Any = state
        for name in path.split("/"):
            if not isinstance(part, Mapping) or name not in part:
                raise CheckpointError(
                    f"the checkpoint in {run} lacks {path!r}; give a folder that `torchrl-atr train` wrote"
                )
            part = part[name]


def read_other(start: Path, run: Path) -> dict[str, Any]:
    """Return the checkpoint of ``start``, from which the new run in ``run`` begins; its entry ``run`` is ``start``.

    Raises:
        ConfigError: if they are one.
        CheckpointError: if there is no whole checkpoint.
    """
    start = find_policy(start)
    if start.resolve() == run.resolve():
        raise ConfigError(f"{run}: a run cannot replace the one that it begins from; give another --output")
    state = load_checkpoint(start)
    check_entries(state, start)
    return {"run": str(start), **state}


def other_parts(config: TrainConfig, other: Mapping[str, Any]) -> set[str]:
    """Return which of robot and transporter a new run has other than the one of :func:`read_other`."""
    theirs, task = located_settings(other["config"], Path(other["run"]))["task"], config.task
    replaced = {part for part in PARTS if getattr(task, part) != theirs[part]}
    return replaced if (task.kp, task.kd) == (theirs["kp"], theirs["kd"]) else {*replaced, "robot"}


def saved_settings(state: Mapping[str, Any], run: Path, imports: Sequence[str] = ()) -> dict[str, Any]:
    """Return the settings of a checkpoint, after importing the modules that they rely on.

    Args:
        state: the checkpoint.
        run: its folder, or the file in it, which the run's own robot files are looked up in.
        imports: modules to import first; with some, those that the run remembers may be missing.

    Raises:
        CheckpointError: if an entry is missing, or a module.
    """
    check_entries(state, run)
    settings = copy.deepcopy(located_settings(state["config"], run.parent if run.is_file() else run))
    for path, value in SINCE.items():
        *groups, name = path.split(".")
        owner: Any = settings
        for group in groups:
            owner = owner.get(group) if isinstance(owner, dict) else None
        if isinstance(owner, dict):
            owner.setdefault(name, value)
    imported = list(imports)
    try:
        import_modules(imports)
        for name in settings.get("imports", ()):
            try:
                import_modules([name], "run where it can be found, or name what registers the same with --import")
                imported.append(name)
            except InputError:
                if not imports:
                    raise
    except InputError as error:
        raise CheckpointError(f"the settings of {run} do not work here: {error}") from error
    return {**settings, "imports": list(dict.fromkeys(imported))}


def checkpoint_config(
    state: Mapping[str, Any], run: Path, imports: Sequence[str] = (), changed: Mapping[str, Any] = MappingProxyType({})
) -> TrainConfig:
    """Return the configuration of a checkpoint.

    Args:
        state: from :func:`~torchrl_atr.training.load_checkpoint`.
        run: its folder, or the file in it.
        imports: modules to import first; with some, those that the run remembers may be missing.
        changed: settings to replace, by dotted name.

    Raises:
        CheckpointError: if an entry is missing, or a setting does not work with this code or on this machine.
    """
    settings = saved_settings(state, run, imports)
    try:
        return make_config(settings, changed)
    except UserError as error:
        raise CheckpointError(f"the settings of {run} do not work here: {error}") from error


def check_model(state: Mapping[str, Any], scene: Scene | None, run: Path, replaced: Collection[str] = ()) -> None:
    """Check that robot and transporter are those that a run was trained with.

    Args:
        state: one without a model, as of a custom env, passes.
        scene: what the run's settings mean here; None for an env that has none.
        run: where ``state`` is from.
        replaced: ``"robot"`` or ``"transporter"`` if that is another one on purpose.

    Raises:
        CheckpointError: if they differ; says in what.
    """
    if state.get("model") is None or scene is None:
        return
    here = describe(scene)
    changed = {part: differences(state["model"], here, [part]) for part in PARTS if part not in replaced}
    names = {"robot": scene.robot.name, "transporter": scene.support.name}
    which = [part for part, texts in changed.items() if texts]
    if which:
        texts = first_few([text for part in which for text in changed[part]])
        culprits = " and ".join(f"{part} {names[part]!r}" for part in which)
        options = " ".join(f"--{part} NAME" for part in which)
        raise CheckpointError(
            f"{run} was trained with another {culprits} than there is here ({texts}); bring back what it was trained "
            f"with, or name what is to take its place with {options} of evaluate, play or train --from {run}"
        )


def deployed_weights(learner: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the moving average of the weights in a learner's state; the last weights if there is none yet."""
    return learner.get("deployed", learner["networks"])


def load_networks(networks: nn.Module, weights: Mapping[str, Any], run: Path) -> None:
    """Load trained weights into networks, all or none.

    Raises:
        CheckpointError: if names or shapes differ, or a number is not finite; its message is one line.
    """
    for name, value in weights.items():
        if isinstance(value, Tensor) and not torch.isfinite(value).all():
            raise CheckpointError(f"the networks in {run} hold a NaN or infinity in {name}; use an earlier checkpoint")
    before = copy.deepcopy(networks.state_dict())
    try:
        networks.load_state_dict(dict(weights))
    except Exception as error:  # an estimator's own set_extra_state or hooks may raise anything
        networks.load_state_dict(before)  # torch has loaded what fits
        lines = [line.strip() for line in str(error).splitlines()[1:]]  # torch's first one names no weight
        culprit = lines[0] if lines and isinstance(error, RuntimeError) else first_line(error)
        raise CheckpointError(
            f"the networks in {run} do not fit these settings ({type(error).__name__}: {shorten(culprit, 200)}); use "
            "the code, the settings and the estimator that trained them"
        ) from error


def check_moments(optimizer: torch.optim.Optimizer, saved: Mapping[str, Any], name: str) -> None:
    """Check the moments in an optimiser's ``saved`` state, which a fused step would use whatever their shapes.

    Raises:
        CheckpointError: if they are of other parameters; names the optimiser.
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

"""Access to attributes and states of an env beyond TorchRL's interface, where the env has them."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.batched_envs import BatchedEnvBase

from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.transforms import CommandCurriculum
from torchrl_atr.runs.checkpoint import CheckpointError


def attribute(env: EnvBase, name: str) -> Any:
    """Return an attribute of the env below all transforms; None if it lacks it, or is made of several envs."""
    base = base_env(env)
    return None if isinstance(base, BatchedEnvBase) else getattr(base, name, None)


def curriculum_of(env: EnvBase) -> CommandCurriculum | None:
    """Return ``env.curriculum`` if that is a command curriculum, else None."""
    found = getattr(env, "curriculum", None)
    return found if isinstance(found, CommandCurriculum) else None


def curriculum_state(curriculum: CommandCurriculum | None) -> dict[str, Any] | None:
    """Return the state of a curriculum without its robots' commands; None for no curriculum."""
    return None if curriculum is None else {"weights": curriculum.weights, **curriculum.get_extra_state()}


def load_curriculum(curriculum: CommandCurriculum | None, state: dict[str, Any] | None) -> None:
    """Restore :func:`curriculum_state` if there are a curriculum and a state."""
    if curriculum is not None and state is not None:
        curriculum.load_weights(state["weights"])
        curriculum.set_extra_state({name: value for name, value in state.items() if name != "weights"})


def widen_curriculum(curriculum: CommandCurriculum | None, state: dict[str, Any] | None) -> None:
    """Add the commands of another run's :func:`curriculum_state`, whatever its grid, to those of a new curriculum."""
    if curriculum is not None and state is not None:
        grid = curriculum.grid
        curriculum.load_weights(grid.merge(grid.fitted(state["weights"]), grid.initial_weights()))


def env_state(env: EnvBase) -> dict[str, Any]:
    """Return the state that the env's next step depends on, in dicts of tensors; empty without ``get_state``.

    It holds that of the base env, its generator ``rng`` and the transforms' states, which alone TorchRL's
    ``env.state_dict()`` has.
    """
    get_state, rng, num_diverged = (attribute(env, name) for name in ("get_state", "rng", "num_diverged"))
    if get_state is None or attribute(env, "set_state") is None:
        return {}
    state = {"env": get_state().to_dict()}
    if isinstance(rng, torch.Generator):
        state["env_rng"] = rng.get_state()
    if num_diverged is not None:
        state["num_diverged"] = num_diverged
    if isinstance(env, TransformedEnv):
        state["transforms"] = dict(env.transform.state_dict())
    return state


def load_env_state(env: EnvBase, state: dict[str, Any]) -> None:
    """Restore :func:`env_state`; a :class:`CheckpointError` says that it is of other transforms."""
    base = base_env(env)
    if "transforms" in state:
        try:
            env.transform.load_state_dict(state["transforms"])
        except (AttributeError, RuntimeError) as error:
            raise CheckpointError(
                f"the robots' episodes in the checkpoint do not fit this code ({' '.join(str(error).split())}); "
                "continue with the code that wrote it, or begin a new run with --from"
            ) from error
    base.set_state(TensorDict(state["env"], batch_size=base.batch_size))
    if "env_rng" in state:
        base.rng.set_state(state["env_rng"])
    if "num_diverged" in state:
        base.num_diverged = state["num_diverged"]

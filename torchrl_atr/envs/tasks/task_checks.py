"""Checks of a task's fields that need no env; the env checks the terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torchrl_atr._errors import InputError
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.models.support import Support
from torchrl_atr.envs.tasks.events import Disturbance, InitialState
from torchrl_atr.envs.tasks.state import StateExtractor

if TYPE_CHECKING:
    from torchrl_atr.envs.tasks.task import Task

_KINDS: dict[str, tuple[Any, str]] = {
    "name": (str, "a text"),
    "robot": (RobotSpec, "a RobotSpec, such as get_robot('a1')"),
    "support": (Support, "a Support, such as FlatGround()"),
    "observations": (Mapping, "a mapping of keys to mappings of names to ObservationTerm"),
    "rewards": (Mapping, "a mapping of names to RewardTerm"),
    "intrinsics": (Mapping, "a mapping of names to IntrinsicParameter"),
    "terminations": (Mapping, "a mapping of names to functions"),
    "disturbances": (Mapping, "a mapping of names to Disturbance"),
    "memory": (Mapping, "a mapping of names to MemoryTerm"),
    "tracking_rewards": ((list, tuple), "a list of names of reward terms"),
    "interpretation": (Interpretation, "Interpretation, such as get_interpretation('default')"),
    "reward_schedule": (Mapping, "a mapping of names of reward terms to functions"),
    "arguments": (Mapping, "a mapping of names to plain values"),
}


def check_task(task: Task) -> None:
    """Check the types of a task's fields, and that the terms that they name exist.

    Raises:
        InputError: names the task, the field, the entry and the remedy.
    """
    for field, (kind, wanted) in _KINDS.items():
        if not isinstance(value := getattr(task, field), kind):
            raise _error(task, f"{field}={value!r}; give {wanted}")
    if "proprio" not in task.observations:
        raise _error(task, "observations lack 'proprio'; give its terms")
    for name, disturbance in task.disturbances.items():
        if not isinstance(disturbance, Disturbance):
            raise _error(task, f"the disturbance {name!r} is {disturbance!r}; give a Disturbance(function, interval)")
    for name, factor in task.reward_schedule.items():
        if name not in task.rewards:
            raise _error(task, f"reward_schedule names {name!r}, which is no reward term")
        if not callable(factor):
            raise _error(task, f"the reward_schedule of {name!r} is {factor!r}; give a function of the progress")
    if not callable(task.reset):
        raise _error(task, f"reset={task.reset!r} cannot be called; give a function")
    if not (task.substep_hook is None or callable(task.substep_hook)):
        raise _error(
            task, f"substep_hook={task.substep_hook!r} cannot be called; give a subclass of SubstepHook, or None"
        )
    if not (isinstance(task.state_extractor, type) and issubclass(task.state_extractor, StateExtractor)):
        raise _error(task, f"state_extractor={task.state_extractor!r}; give a subclass of StateExtractor")


def check_components(names: Sequence[str], units: Sequence[str]) -> None:
    """Check the names and units of a command's components.

    Raises:
        InputError: if these are not lists of strings, or of different lengths.
    """
    for argument, value in (("names", names), ("units", units)):
        if not isinstance(value, list | tuple) or not value or not all(isinstance(each, str) for each in value):
            raise InputError(f"{argument}={value!r} of a command; give a tuple of texts, one for each component")
    if len(names) != len(units):
        raise InputError(f"the components {names} of a command have {len(units)} units; give {len(names)}")


def checked_start(task: Task, begun: Any, scene: Scene, n: int) -> InitialState:
    """Return the initial states that a task's ``reset`` returned for n episodes, checked.

    Raises:
        InputError: unless it is an :class:`~torchrl_atr.envs.tasks.events.InitialState` of n episodes in this scene.
    """
    if not isinstance(begun, InitialState):
        raise _error(task, f"reset returned {type(begun).__name__}; return an InitialState(qpos, qvel, moving)")
    shapes = {"qpos": (n, scene.model.nq), "qvel": (n, scene.model.nv), "moving": (n,)}
    for field, shape in shapes.items():
        value = getattr(begun, field)
        got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        if got != shape or (field == "moving" and value.dtype != torch.bool):
            kind = f" of {value.dtype}" if isinstance(value, Tensor) else ""
            wanted = f"{'bool' if field == 'moving' else 'floats'} of {shape}"
            raise _error(task, f"reset returned {field} of {got}{kind}; it must be {wanted}")
    return begun


def _error(task: Task, problem: str) -> InputError:
    return InputError(f"task {task.name!r}: {problem}")

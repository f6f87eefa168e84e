"""Tasks by name, for configurations and the command line."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from torchrl_atr._checks import check_kind
from torchrl_atr._errors import InputError
from torchrl_atr._registry import Registry, nearest
from torchrl_atr.envs.tasks.riding import riding
from torchrl_atr.envs.tasks.task import Task
from torchrl_atr.envs.tasks.walking import walking

TASKS: Registry[Callable[..., Task]] = Registry("task")
"""Registry of functions that return a :class:`~torchrl_atr.envs.tasks.Task`; register your own."""
TASKS.register("riding", riding)
TASKS.register("walking", walking)


def make_task(name: str, **arguments: Any) -> Task:
    """Return a task by its name.

    Args:
        name: of a registered task.
        **arguments: of its function, such as ``robot``.

    Raises:
        UnknownNameError: for an unknown task.
        InputError: for an argument that the task does not have, which is named, or a function of another return type.

    Example:
        >>> make_task("riding", robot="go1").robot.name
        'go1'
    """
    function = TASKS.get(name)
    known = inspect.signature(function).parameters
    for argument in arguments:
        if argument not in known:
            raise InputError(f"the task {name!r} has no argument {argument!r}; {nearest(argument, known)}")
    return check_kind(f"the task {name!r}", function(**arguments), Task, "a function that returns a Task")

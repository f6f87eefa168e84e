"""Changes of a running env's randomisation, sensors and pushes: checked as a whole, in force from the next episode."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from tensordict import NestedKey
from torch import Tensor

from torchrl_atr._checks import check_kind
from torchrl_atr._errors import InputError, UserError
from torchrl_atr._inference import keeps_normal_tensors
from torchrl_atr._registry import nearest
from torchrl_atr.envs.tasks.events import Disturbance, Pushes
from torchrl_atr.envs.tasks.intrinsic_parameters import Randomization
from torchrl_atr.envs.tasks.observation_terms import Group
from torchrl_atr.envs.tasks.sensors import SensorSet, exact, with_sensors
from torchrl_atr.envs.tasks.task import Task

if TYPE_CHECKING:
    from torchrl_atr.envs.tasks.runner import EpisodeRunner

PARAMETERS = ("command_bounds", "sensors", "randomization", "pushes")
"""Names of what can be changed in a running env."""
Ranges = Mapping[str, Sequence[float]]
"""Lowest and highest value by intrinsic parameter, in its own unit."""


@dataclass(frozen=True)
class Changes:
    """Checked changes of an :class:`~torchrl_atr.envs.tasks.runner.EpisodeRunner`; None leaves a part as it is.

    Attributes:
        ends: scaled ends of the ranges of the intrinsic parameters, (2, size).
        observations: the groups of observation terms, with the errors of their sensors.
        disturbances: by name.
    """

    ends: Tensor | None = None
    observations: Mapping[NestedKey, Group] | None = None
    disturbances: Mapping[str, Disturbance] | None = None


def checked_changes(
    runner: EpisodeRunner,
    sensors: str | SensorSet | None = None,
    randomization: Randomization | Ranges | None = None,
    pushes: bool | Pushes | None = None,
) -> Changes:
    """Return the changes for a runner, which stays as it is; :meth:`EpisodeRunner.change` makes them.

    Args:
        runner: to change.
        sensors: name of a sensor set, or your own; terms that it does not name become exact.
        randomization: ``"train"``, ``"test"`` or ``"off"``, or new ranges of some parameters, between which they are
            drawn; their scaling for the networks stays that of the task's training range.
        pushes: whether robots are pushed, or sizes and interval.

    Raises:
        InputError: names the argument, and a value or a name that does not fit the runner's task.
    """
    ends = observations = disturbances = None
    with _named("sensors"):
        if sensors is not None:
            check_kind("sensors", sensors, (str, Mapping), "the name of a sensor set, or your own")
            proprio = with_sensors(exact(runner.task.observations["proprio"]), sensors)
            observations = {**runner.task.observations, "proprio": proprio}
    with _named("randomization"):
        if randomization is not None:
            ends = runner.intrinsics.ends(randomization, runner.ends)
    with _named("pushes"):
        if pushes is not None:
            disturbances = _pushed(runner.task, Pushes.of(pushes))
    return Changes(ends, observations, disturbances)


def _pushed(task: Task, pushes: Pushes | None) -> dict[str, Disturbance]:
    """Return a task's disturbances with other pushes, or without any."""
    changed = dict(task.disturbances)
    names = [name for name, each in changed.items() if each.is_push]
    if not names and changed:
        raise InputError(
            f"none of the disturbances of task {task.name!r} is a push: {', '.join(changed)}; give the one that is "
            "is_push=True, and its function an argument pushes"
        )
    if not names and pushes is not None:
        raise InputError(
            f"the env of task {task.name!r} was made without any; make it with pushes=True, and switch them off until "
            "they are wanted"
        )
    for name in names:
        push = changed.pop(name)
        if pushes is not None:
            function = partial(push.function, pushes=pushes)
            changed[name] = replace(push, function=function, interval=pushes.interval)
    return changed


@contextmanager
def _named(argument: str) -> Iterator[None]:
    """Name the argument in errors of its value, if they do not."""
    try:
        yield
    except UserError as error:
        text = str(error)
        raise InputError(text if text.startswith(argument) else f"{argument}: {text}") from error


class Reconfigurable:
    """Mixin of envs of a task whose parameters can be changed while they run, in workers as well.

    Attributes:
        runner: of the task.
    """

    runner: EpisodeRunner

    @keeps_normal_tensors
    def reconfigure(self, **changes: Any) -> None:
        """Change parameters of the env, all or none; each robot's next episode is the first that they apply to.

        Args:
            **changes: ``sensors``, ``randomization`` and ``pushes`` as :func:`checked_changes` takes them, and
                ``command_bounds``, the largest speed (m/s) and yaw rate (rad/s) that the command curriculum draws,
                whole multiples of its bins; a command in force lasts its window.

        Raises:
            InputError: (a ``ValueError``) names the parameter that is unknown, or has a value that does not fit.

        Example:
            >>> from torchrl_atr.envs import make_riding_env
            >>> env = make_riding_env(num_envs=2, seed=0)
            >>> env.reconfigure(command_bounds=(2.0, 1.0), sensors="realistic", pushes=False)
            >>> env.reconfigure(randomization={"payload": (0.0, 1.0)})
        """
        for name in changes:
            if name not in PARAMETERS:
                raise InputError(f"an env has no parameter {name!r} to change; {nearest(name, PARAMETERS)}")
        limits: Any = getattr(getattr(self, "curriculum", None), "limits", None)
        bounds = changes.pop("command_bounds", None)
        with _named("command_bounds"):
            if bounds is not None and limits is None:
                raise InputError("the env has no command curriculum; make it with make_env")
            part = None if bounds is None else limits.within(bounds)
        self.runner.change(checked_changes(self.runner, **changes))
        if part is not None:
            limits.part = part

    def try_reconfigure(self, **changes: Any) -> str:
        """Reconfigure; return the message of an error, which a worker must not raise, else an empty text."""
        try:
            self.reconfigure(**changes)
        except UserError as error:
            return str(error)
        return ""

"""Overrides of a task's reward weights and ranges of intrinsic parameters, by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest
from torchrl_atr.envs.tasks.task import Task


@dataclass(frozen=True)
class Ranges:
    """New ranges of an intrinsic parameter, in its own unit; an empty one leaves the range as it is.

    Attributes:
        train: lowest and highest value in training.
        test: in the test of generalisation.
    """

    train: tuple[float, ...] = ()
    test: tuple[float, ...] = ()


def override(task: Task, weights: Mapping[str, float], ranges: Mapping[str, Ranges]) -> Task:
    """Return a task with other weights of reward terms and other ranges of intrinsic parameters.

    Args:
        task: with those terms and parameters.
        weights: by reward term.
        ranges: by intrinsic parameter.

    Raises:
        InputError: for a term or a parameter that the task does not have, or an invalid range.

    Example:
        >>> from torchrl_atr.envs.tasks import riding
        >>> task = override(riding(), {"heading_alignment": -2.0}, {"payload": Ranges(train=(0.0, 2.0))})
        >>> task.rewards["heading_alignment"].weight, task.intrinsics["payload"].train
        (-2.0, (0.0, 2.0))
    """
    rewards, intrinsics = dict(task.rewards), dict(task.intrinsics)
    for name, weight in weights.items():
        rewards[name] = _entry(rewards, name, f"task.rewards.{name}={weight:g}", task).weighted(weight)
    for name, own in ranges.items():
        parameter = _entry(intrinsics, name, f"task.randomization.{name}", task)
        train, test = own.train or parameter.train, own.test or parameter.test
        try:
            intrinsics[name] = dataclasses.replace(parameter, train=train, test=test)
        except InputError as error:
            raise InputError(f"task.randomization.{name}: {error}") from error
    return task.replace(rewards=rewards, intrinsics=intrinsics) if weights or ranges else task


def _entry(entries: Mapping[str, Any], name: str, given: str, task: Task) -> Any:
    if name not in entries:
        raise InputError(f"{given}: the task {task.name!r} has no {name!r}; {nearest(name, entries)}")
    return entries[name]

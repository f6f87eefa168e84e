"""Observation terms as data, and the groups of an env's observations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from tensordict import NestedKey, unravel_key
from torch import Tensor

from torchrl_atr._checks import check_key, check_number
from torchrl_atr._errors import InputError
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.tasks import mirrors
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.mirrors import Mirror
from torchrl_atr.envs.tasks.term_checks import try_term

INTRINSIC = ("privileged", "intrinsic")
"""Key of the intrinsic parameters, which are not observation terms."""
RESERVED = (
    "command",
    "observation",
    "moving_start",
    "action",
    "reward",
    "reward_terms",
    "done",
    "terminated",
    "truncated",
)
"""Entries that every env reads or writes at its root besides the groups."""


class ObservationError(InputError):
    """Error of an observation term that cannot be used; the message names it."""


@dataclass(frozen=True)
class ObservationTerm:
    """Component of an observation.

    Attributes:
        function: from a :class:`~torchrl_atr.envs.tasks.context.StepContext` to (N, D) floats, raw SI units.
        mirror: its mirror image, which symmetric networks need: D signs, or a function of the scene that returns a
            matrix (D, D), such as :func:`~torchrl_atr.envs.tasks.mirrors.joints`; None if there is none.
        label: its name in tables; its key by default.
        parts: names of its components in tables, such as ``"xyz"``.
        unit: of all of them, or a sequence with the unit of each.
        noise: standard deviation of white noise that is added at every step, in its unit.
        bias: standard deviation of an error that is drawn for every episode, in its unit.
        bias_time: correlation time of the bias, s: it wanders slowly and keeps its standard deviation. Infinite by
            default: it stays for the episode.
        delay: largest delay in control steps, up to 50; every episode draws its own, uniformly from 0 on, and observes
            the interpolation between the values of the two steps around it.

    Raises:
        ObservationError: if the function cannot be called, or a number is out of range.

    Example:
        >>> height = ObservationTerm(lambda context: context.state.position[:, 2:], mirror=(1.0,), unit="m", noise=0.01)
    """

    function: Callable[[StepContext], Tensor]
    mirror: Mirror | None = None
    label: str = ""
    parts: Sequence[str] = ()
    unit: str | Sequence[str] = ""
    noise: float = 0.0
    bias: float = 0.0
    bias_time: float = math.inf
    delay: float = 0.0

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise ObservationError(
                f"function={self.function!r} of an observation term cannot be called; give a function"
            )
        try:
            for name in ("noise", "bias"):
                check_number(name, getattr(self, name), 0.0)
            check_number("delay", self.delay, 0.0, 50.0)
            if self.bias_time != math.inf:
                check_number("bias_time", self.bias_time, above=0.0)
        except InputError as error:
            raise ObservationError(f"{error} (of an observation term)") from None

    def unit_of(self, component: int) -> str:
        """Return the unit of a component."""
        return self.unit if isinstance(self.unit, str) else self.unit[component]

    @property
    def has_errors(self) -> bool:
        """Flag of a term that is observed with an error."""
        return bool(self.noise or self.bias or self.delay)


Group = Mapping[str, ObservationTerm]
"""Terms by name, concatenated in their order."""


class Observations:
    """Groups of observation terms of an env, checked once.

    Args:
        groups: by key, the terms by name.
        context: of N robots, on which every term is checked.

    Attributes:
        groups: as given.
        sizes: components of every term, by key and name.

    Raises:
        ObservationError: names the term that is not an :class:`ObservationTerm`, fails, does not return floats of shape
            (N, D), or whose mirror image has another size, or the group that is empty or has the key of an entry that
            the env writes.
    """

    def __init__(self, groups: Mapping[NestedKey, Group], context: StepContext) -> None:
        _check_groups(groups)
        self.groups = {key: dict(group) for key, group in groups.items()}
        self.sizes = {
            key: {name: _try(key, name, term, context) for name, term in group.items()}
            for key, group in self.groups.items()
        }

    def __call__(self, context: StepContext) -> dict[NestedKey, Tensor]:
        """Compute all groups without errors, (N, size) each."""
        return {
            key: torch.cat([term.function(context) for term in group.values()], -1)
            for key, group in self.groups.items()
        }

    def labels(self, key: NestedKey) -> list[tuple[str, str]]:
        """Return name in tables and unit of each component of a group."""
        labels = []
        for name, size in self.sizes[key].items():
            term = self.groups[key][name]
            title = term.label or name.replace("_", " ")
            for i in range(size):
                part = term.parts[i] if i < len(term.parts) else (str(i) if size > 1 else "")
                labels.append((f"{title} {part}".rstrip(), term.unit_of(i)))
        return labels

    def names(self, key: NestedKey) -> list[str]:
        """Return a unique name for each component of a group, such as ``contacts[0]``."""
        return [f"{name}[{i}]" for name, size in self.sizes[key].items() for i in range(size)]

    def reflection(self, key: NestedKey, scene: Scene) -> Tensor:
        """Return the reflection matrix R of a group, (D, D).

        Raises:
            ObservationError: names a term that has none, or one of another size.
            RobotError: if the robot is not symmetric.
        """
        parts = []
        for name, term in self.groups[key].items():
            if term.mirror is None:
                raise ObservationError(
                    f"the observation term {_place(key, name)} has no mirror image; give it mirror=..., or train with "
                    "symmetric=false"
                )
            parts.append(_mirror(key, name, term.mirror, scene, self.sizes[key][name]))
        return torch.block_diag(*parts)


def _place(key: NestedKey, name: str) -> str:
    return f"{name!r} of {key!r}"


def _mirror(key: NestedKey, name: str, mirror: Mirror, scene: Scene, size: int) -> Tensor:
    return mirrors.matrix(mirror, scene, size, f"the observation term {_place(key, name)}", ObservationError)


def _check_groups(groups: Mapping[NestedKey, Group]) -> None:
    for key, group in groups.items():
        check_key("the key of a group of observations", key)
        if unravel_key(key) != key:
            raise ObservationError(f"observations: write the key {key!r} as {unravel_key(key)!r}")
        path = key if isinstance(key, tuple) else (key,)
        if path[0] in RESERVED or key == INTRINSIC:
            raise ObservationError(f"observations: {key!r} is an entry of every env; give the terms another key")
        for i in range(1, len(path)):
            if path[:i] in groups or (i == 1 and path[0] in groups):
                raise ObservationError(f"observations: {key!r} lies inside another group; give it another key")
        if not isinstance(group, Mapping) or not group:
            raise ObservationError(f"observations: {key!r} holds {group!r}; give it ObservationTerms by name")


def _try(key: NestedKey, name: str, term: ObservationTerm, context: StepContext) -> int:
    if not isinstance(name, str) or not isinstance(term, ObservationTerm):
        raise ObservationError(f"the observation term {_place(key, name)} is {term!r}; give an ObservationTerm")
    place = f"the observation term {_place(key, name)}"
    size = try_term(place, term.function, context, (len(context.command), None), error=ObservationError).shape[-1]
    if not isinstance(term.unit, str) and len(term.unit) != size:
        raise ObservationError(
            f"{place} has {size} components and {len(term.unit)} units; give it one unit for all, or one for each"
        )
    if term.mirror is not None and not callable(term.mirror):
        _mirror(key, name, term.mirror, context.scene, size)
    return size

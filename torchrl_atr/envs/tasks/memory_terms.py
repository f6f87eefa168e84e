"""Memory terms as data: per-robot quantities that are carried from one control step to the next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrl_atr._errors import InputError
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.term_checks import try_term


class MemoryTermError(InputError):
    """Error of a memory term that cannot be used; the message names it."""


@dataclass(frozen=True)
class MemoryTerm:
    """Quantity that is carried from step to step, such as a clock or the time that a foot has been in the air.

    It is updated before observations and rewards, which see the new value.

    Attributes:
        size: number of components D.
        update: from a :class:`~torchrl_atr.envs.tasks.context.StepContext`, whose memory is that of the step before, to
            the new value, (N, D) float32.
        start: the same at the start of an episode; zero by default.

    Example:
        >>> clock = MemoryTerm(1, lambda c: (c.memory["clock"] + 0.02 * 2.0) % 1.0)
    """

    size: int
    update: Callable[[StepContext], Tensor]
    start: Callable[[StepContext], Tensor] | None = None


def started(terms: Mapping[str, MemoryTerm], context: StepContext) -> dict[str, Tensor]:
    """Return the memory at the start of episodes, (n, D) by name; the terms must have passed :func:`check`."""
    n, memory = len(context.command), {}
    for name, term in terms.items():
        zero = torch.zeros(n, term.size, dtype=torch.float32)
        memory[name] = zero if term.start is None else term.start(context)
    return memory


def updated(terms: Mapping[str, MemoryTerm], context: StepContext) -> dict[str, Tensor]:
    """Return the memory after a step, (N, D) by name; ``context`` holds that of the step before."""
    return {name: term.update(context) for name, term in terms.items()}


def check(terms: Mapping[str, MemoryTerm], context: StepContext) -> None:
    """Try every term on N robots.

    Raises:
        MemoryTermError: names the term that is not a :class:`MemoryTerm`, fails, or returns another shape.
    """
    for name, term in terms.items():
        if not isinstance(term, MemoryTerm):
            raise MemoryTermError(f"the memory term {name!r} is {term!r}; give a MemoryTerm")
    for values_of in (started, updated):
        context.memory = {name: _try(values_of, name, term, context) for name, term in terms.items()}


def _try(values_of: Callable[..., dict[str, Tensor]], name: str, term: MemoryTerm, context: StepContext) -> Tensor:
    def function(context: StepContext) -> Tensor:
        return values_of({name: term}, context)[name]

    shape = (len(context.command), term.size)
    return try_term(f"the memory term {name!r}", function, context, shape, error=MemoryTermError)

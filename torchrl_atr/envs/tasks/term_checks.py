"""Check of what the functions of terms return: one place for rewards, observations, memory and terminations."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchrl_atr._errors import InputError
from torchrl_atr.envs.tasks.context import StepContext


def try_term(
    what: str,
    function: Callable[[StepContext], Tensor],
    context: StepContext,
    shape: tuple[int | None, ...],
    dtype: torch.dtype | None = torch.float32,
    error: type[InputError] = InputError,
) -> Tensor:
    """Return the value of a term's function on a context of N robots.

    Args:
        what: kind and name of the term, for messages.
        function: of the term.
        context: of N robots.
        shape: that the value must have; None for a size that is free.
        dtype: that it must have; None for any floating one.
        error: exception type to raise.

    Raises:
        InputError: (or ``error``) names the term that fails, or returns another shape or dtype.

    Example:
        >>> from types import SimpleNamespace
        >>> context = SimpleNamespace(command=torch.zeros(4, 2))
        >>> try_term("the reward term 'mine'", lambda c: c.command, context, (4,))
        Traceback (most recent call last):
        torchrl_atr._errors.InputError: the reward term 'mine' returned (4, 2) of float32; it must return float32 of \
shape (4,)
    """
    try:
        value = function(context)
    except Exception as failure:  # of the user's function
        raise error(f"{what} failed: {type(failure).__name__}: {failure}") from failure
    if not _fits(value, shape, dtype):
        got = f"{tuple(value.shape)} of {_name(value.dtype)}" if isinstance(value, Tensor) else type(value).__name__
        sizes = ", ".join("D" if size is None else str(size) for size in shape) + "," * (len(shape) == 1)
        raise error(f"{what} returned {got}; it must return {_name(dtype)} of shape ({sizes})")
    return value


def _fits(value: object, shape: tuple[int | None, ...], dtype: torch.dtype | None) -> bool:
    if not isinstance(value, Tensor) or value.ndim != len(shape):
        return False
    same_type = value.is_floating_point() if dtype is None else value.dtype == dtype
    return same_type and all(size in (None, got) for size, got in zip(shape, value.shape))


def _name(dtype: torch.dtype | None) -> str:
    return "floats" if dtype is None else str(dtype).removeprefix("torch.")

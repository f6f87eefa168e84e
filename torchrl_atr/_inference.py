"""State that outlives ``torch.inference_mode``: tensors made in it can never be written to outside of it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import torch

F = TypeVar("F", bound=Callable[..., Any])


def keeps_normal_tensors(method: F) -> F:
    """Decorate a method that makes or changes tensors which an object keeps.

    Called in ``torch.inference_mode``, it runs outside of it, without gradients: what it keeps can be changed in any
    mode later, and what it returns can be saved for a backward pass. Elsewhere it runs as it is, gradients included.

    Example:
        >>> @keeps_normal_tensors
        ... def zeros():
        ...     return torch.zeros(2)
        >>> with torch.inference_mode():
        ...     zeros().is_inference()
        False
    """

    @functools.wraps(method)
    def call(*arguments: Any, **options: Any) -> Any:
        if not torch.is_inference_mode_enabled():
            return method(*arguments, **options)
        with torch.inference_mode(False), torch.no_grad():
            return method(*arguments, **options)

    return call  # type: ignore[return-value]

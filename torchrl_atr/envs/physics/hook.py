"""Hook of a task that acts on the simulations before every substep."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any

from torch import Tensor

from torchrl_atr._errors import InputError

if TYPE_CHECKING:
    from torchrl_atr.envs.physics.engine import Engine


class SubstepHook:
    """Base class of hooks that act on an engine before each substep; this one does nothing.

    Args:
        engine: engine whose tensors the hook reads and writes.

    Attributes:
        state: the hook's own live state by name, (N, ...) each, float64; part of the engine's state.

    Example:
        >>> class Gravel(SubstepHook):
        ...     def apply(self, dt):
        ...         self.engine.qfrc_applied[:, 0] = -2.0 * self.engine.qvel[:, 0]
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.state: dict[str, Tensor] = {}

    def start(self, rows: Tensor) -> None:
        """Begin episodes of ``rows``, (n,), whose parameters and state the engine has just written."""
        self.refresh(rows)

    def refresh(self, rows: Tensor) -> None:
        """Recompute values that depend on the engine's fields for ``rows``, (n,)."""

    def apply(self, dt: float) -> None:
        """Act on all simulations before a substep of ``dt`` seconds, for example by ``engine.qfrc_applied``."""

    def reset_diverged(self, rows: Tensor) -> None:
        """Clear the hook's state of simulations that diverged, (N,) bool."""


def check_hook(hook: Any, num_envs: int, taken: Collection[str]) -> None:
    """Check the hook of an engine.

    Args:
        hook: to check.
        num_envs: N.
        taken: names of the engine's own state.

    Raises:
        InputError: if it is not a :class:`SubstepHook`, or its state has not N rows or a name that is taken.
    """
    if not isinstance(hook, SubstepHook):
        raise InputError(f"a task's hook made {hook!r} of an engine; give a subclass of SubstepHook")
    name = type(hook).__name__
    if not hasattr(hook, "state"):
        raise InputError(f"the hook {name} has no state; call super().__init__(engine) in its __init__")
    for entry, value in hook.state.items():
        if entry in taken:
            raise InputError(f"the hook {name} calls an entry of its state {entry!r}, as the engine does; rename it")
        if not isinstance(value, Tensor) or value.shape[:1] != (num_envs,):
            raise InputError(f"the hook {name}: its state {entry!r} must be a tensor of {num_envs} rows")

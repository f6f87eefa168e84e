"""What a task does to the simulations before every substep."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    from torchrl_atr.envs.physics.engine import Engine


class SubstepHook:
    """Acts on an engine before each of its substeps; this one does nothing, subclasses drive a transporter and such.

    Args:
        engine: whose tensors it reads and writes.

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
        """Derive anew what follows from the engine's fields for ``rows``, (n,)."""

    def apply(self, dt: float) -> None:
        """Act on all simulations before a substep of ``dt`` seconds, such as by ``engine.qfrc_applied``."""

    def lose(self, rows: Tensor) -> None:
        """Forget what was known of simulations that diverged, (N,) bool."""

"""Part of a command grid that commands are drawn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torch import Tensor

from torchrl_atr._checks import check_pair
from torchrl_atr._errors import InputError
from torchrl_atr.envs.transforms.grid import CommandGrid


class CommandLimits:
    """Limits of what is drawn from a grid, whose weights beyond them are kept, and may grow.

    Args:
        grid: all commands.

    Attributes:
        part: grid of the same bins within the limits; at first the whole grid.

    Example:
        >>> limits = CommandLimits(CommandGrid())
        >>> limits.part = limits.within((2.0, 1.0))
        >>> limits.part.shape
        (21, 11)
    """

    def __init__(self, grid: CommandGrid) -> None:
        self.grid = self.part = grid

    def within(self, bounds: Sequence[float]) -> CommandGrid:
        """Return the part of the grid within ``bounds``, the largest ``|c_v|`` (m/s) and ``|c_omega|`` (rad/s).

        Raises:
            InputError: Not two positive numbers, not whole multiples of the bin, or beyond the grid's bounds.
        """
        pair = check_pair("bounds", bounds, "two positive numbers (m/s, rad/s)")
        if any(own > most for own, most in zip(pair, self.grid.bounds)):
            raise InputError(f"bounds={pair} exceed those of the grid, {self.grid.bounds} (m/s, rad/s); stay within")
        initial = min(pair[0], self.grid.initial[0]), min(pair[1], self.grid.initial[1])
        try:
            return replace(self.grid, bounds=pair, initial=initial)
        except ValueError as error:
            raise InputError(str(error)) from error

    def sample(self, weights: Tensor, uniforms: Tensor) -> tuple[Tensor, Tensor]:
        """Draw commands within the limits, as :meth:`CommandGrid.sample` does; the cells are those of the whole grid.

        Where no command within the limits has a weight, they are drawn as at the beginning.
        """
        if self.part.bounds == self.grid.bounds:
            return self.grid.sample(weights, uniforms)
        own = self.part.fitted(weights)
        if not bool((own > 0).any()):
            own = self.part.initial_weights().to(weights)
        commands, cells = self.part.sample(own, uniforms)
        return commands, self.grid.cell_of(self.part.centres(cells))

"""Grid over the command space and the pure rule that grows it (the paper's "Curriculum Strategy").

Questions A2 to A5: the printed ``max(P + delta, 1)`` is a cap, ``min(w + delta, 1)``, on
unnormalised weights in [0, 1]; a cell is drawn with probability proportional to its weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor
from torch.nn import functional

from torchrl_atr._checks import check_flag, check_number, check_pair

_TOLERANCE = 1e-6


def _whole(ratio: float) -> bool:
    return abs(ratio - round(ratio)) < _TOLERANCE


@dataclass(frozen=True)
class CommandGrid:
    """Cells over (c_v, c_omega), centred on integer multiples of the bin, and the rule that grows them.

    The grid holds no tensor: every method is a pure function of the weights it is given, so that the same
    rule serves an environment, a learner and a plot. Edge cells are cut at the bounds, so no command leaves
    the box. Neighbours are found by integer offsets ``round(expansion / bin)``: comparing the centres as
    floats loses cells.

    Args:
        bounds: Largest ``|c_v|`` (m/s) and ``|c_omega|`` (rad/s); whole multiples of ``bin_size``.
        bin_size: Cell size along each axis, m/s and rad/s.
        initial: Half-widths of the box that starts with weight 1; a cell belongs to it if its centre does.
        expansion: The paper's Delta, m/s and rad/s: the reach of a success along each axis.
        increment: The paper's delta, added to each cell of the neighbourhood for each success, in (0, 1].
        count_own_twice: Whether the succeeding cell gains the increment twice, as the preset ``legged_gym``
            interprets ``c + Delta``.
        forward_only: Whether no speed below zero is drawn.
        still: Share of the draws that command standing still, whatever the weights; in [0, 1].
        turning: Share that commands a yaw rate alone.
        straight: Share that commands a speed alone.

    Raises:
        ValueError: A value is not positive and finite, or does not fit the grid.

    Example:
        >>> grid = CommandGrid()
        >>> grid.shape, int(grid.initial_weights().sum())
        ((151, 21), 15)
    """

    bounds: tuple[float, float] = (15.0, 2.0)
    bin_size: tuple[float, float] = (0.2, 0.2)
    initial: tuple[float, float] = (0.5, 0.3)
    expansion: tuple[float, float] = (0.2, 0.2)
    increment: float = 0.1
    count_own_twice: bool = False
    forward_only: bool = False
    still: float = 0.0
    turning: float = 0.0
    straight: float = 0.0

    def __post_init__(self) -> None:
        for name in ("bounds", "bin_size", "initial", "expansion"):
            wanted = "two finite, positive numbers (c_v, c_omega)"
            pair = check_pair(name, getattr(self, name), wanted, positive=name != "expansion")
            object.__setattr__(self, name, pair)
        check_flag("count_own_twice", self.count_own_twice)
        check_flag("forward_only", self.forward_only)
        for name in ("still", "turning", "straight"):
            check_number(name, getattr(self, name), 0.0, 1.0)
        if self.still + self.turning + self.straight > 1.0 + _TOLERANCE:
            raise ValueError("still, turning and straight are shares of all draws; they add up to more than 1")
        if not 0 < check_number("increment", self.increment) <= 1:
            raise ValueError(f"increment must be in (0, 1], got {self.increment}")
        for axis, (bound, size, initial, reach) in enumerate(
            zip(self.bounds, self.bin_size, self.initial, self.expansion)
        ):
            name = ("c_v", "c_omega")[axis]
            if not _whole(bound / size):
                raise ValueError(f"bounds[{axis}] ({name}) = {bound} must be a whole multiple of its bin {size}")
            if initial > bound + _TOLERANCE:
                raise ValueError(f"initial[{axis}] ({name}) = {initial} must lie within its bound {bound}")
            if reach > _TOLERANCE and round(reach / size) == 0:
                raise ValueError(
                    f"expansion[{axis}] ({name}) = {reach} reaches no neighbour of a {size} bin; "
                    "use at least one bin, or 0 to keep this axis as it is"
                )

    @property
    def half(self) -> tuple[int, int]:
        """Cells on either side of the centre cell, along each axis."""
        return round(self.bounds[0] / self.bin_size[0]), round(self.bounds[1] / self.bin_size[1])

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along c_v and c_omega."""
        return 2 * self.half[0] + 1, 2 * self.half[1] + 1

    @property
    def radius(self) -> tuple[int, int]:
        """Neighbours on either side that a success reaches, in cells."""
        return round(self.expansion[0] / self.bin_size[0]), round(self.expansion[1] / self.bin_size[1])

    def initial_weights(self) -> Tensor:
        """Return P_0 as weights: 1 in the initial box, 0 outside.

        Returns:
            float32 ``shape``.
        """
        inside = [math.floor(box / size + _TOLERANCE) for box, size in zip(self.initial, self.bin_size)]
        weights = torch.zeros(self.shape, dtype=torch.float32)
        rows, columns = (slice(half - k, half + k + 1) for half, k in zip(self.half, inside))
        weights[rows, columns] = 1.0
        return self._allowed(weights)

    def _allowed(self, weights: Tensor) -> Tensor:
        """Return the weights with zeros for speeds that are never drawn."""
        if not self.forward_only:
            return weights
        return weights.index_fill(0, torch.arange(self.half[0], device=weights.device), 0.0)

    @property
    def uniforms(self) -> int:
        """Number of uniform variates that :meth:`sample` needs per command."""
        return 4 if self.still + self.turning + self.straight > 0.0 else 3

    def validate(self, weights: Tensor) -> Tensor:
        """Return ``weights`` if they are weights of this grid.

        Raises:
            ValueError: Wrong shape, a value outside [0, 1] or not finite, no positive weight at all, or one of a speed
                that is never drawn.
        """
        if tuple(weights.shape) != self.shape:
            raise ValueError(f"weights must have this grid's shape {self.shape}, got {tuple(weights.shape)}")
        if not bool(((weights >= 0) & (weights <= 1)).all()):
            raise ValueError("weights must be finite and in [0, 1]")
        if not bool((weights > 0).any()):
            raise ValueError("weights must have at least one positive cell to draw commands from")
        if not torch.equal(weights, self._allowed(weights)):
            raise ValueError("weights of speeds below zero must be 0: the grid is forward_only")
        return weights

    def fitted(self, weights: Tensor) -> Tensor:
        """Return weights of a grid with the same bins and other bounds, cropped or zero-padded to this one's.

        Args:
            weights: of that grid, with odd numbers of cells along both axes.

        Returns:
            ``shape``, without those of speeds that are never drawn; all zero if no weight was within these bounds.

        Example:
            >>> narrow, wide = CommandGrid(bounds=(2.0, 1.0)), CommandGrid()
            >>> torch.equal(wide.fitted(narrow.initial_weights()), wide.initial_weights())
            True
        """
        rows, columns = ((own - other) // 2 for own, other in zip(self.shape, weights.shape, strict=True))
        return self._allowed(functional.pad(weights, (columns, columns, rows, rows)))

    def centres(self, cells: Tensor) -> Tensor:
        """Return the commands at the centres of flat cell indices.

        Args:
            cells: int64 ``(*B,)``, ``row * shape[1] + column``.

        Returns:
            float64 ``(*B, 2)``, m/s and rad/s.
        """
        index = torch.stack([cells // self.shape[1] - self.half[0], cells % self.shape[1] - self.half[1]], -1)
        return index * torch.tensor(self.bin_size, dtype=torch.float64, device=cells.device)

    def cell_of(self, commands: Tensor) -> Tensor:
        """Return the flat index, int64 ``(*B,)``, of the cell nearest to each command ``(*B, 2)``."""
        index = torch.stack(
            [
                (commands[..., axis].double() / self.bin_size[axis]).round().long().clamp(-half, half) + half
                for axis, half in enumerate(self.half)
            ]
        )
        return index[0] * self.shape[1] + index[1]

    def _edges(self, cells: Tensor) -> tuple[Tensor, Tensor]:
        """Return the lowest and highest command of each cell, cut at the bounds: two float64 ``(*B, 2)``."""
        low, high = _all_edges(self, cells.device)
        return low[cells], high[cells]

    def sample(self, weights: Tensor, uniforms: Tensor) -> tuple[Tensor, Tensor]:
        """Draw commands: a cell with probability proportional to its weight, then uniformly inside the cell.

        A function of uniform numbers instead of a generator, so that the same seed draws the same commands on
        every device.

        Args:
            weights: ``shape``, at least one of them positive.
            uniforms: float64 ``(n, uniforms)`` in [0, 1): the cell, c_v and c_omega inside it, and the kind of command.

        Returns:
            Commands, float64 ``(n, 2)`` in m/s and rad/s, and their flat cell indices, int64 ``(n,)``.
        """
        cumulative = weights.reshape(-1).cumsum(0, dtype=torch.float64)
        total = cumulative[-1]
        # u * total may round up to the total, past the last cell that has any weight
        target = torch.minimum(uniforms[:, 0] * total, torch.nextafter(total, torch.zeros_like(total)))
        cells = torch.searchsorted(cumulative, target, right=True)
        low, high = self._edges(cells)
        commands = low + uniforms[:, 1:3] * (high - low)
        if self.uniforms == 3:
            return commands, cells
        kind = uniforms[:, 3]
        ends = torch.tensor([self.still, self.turning, self.straight], dtype=torch.float64).cumsum(0).tolist()
        no_speed, no_yaw_rate = kind < ends[1], (kind < ends[0]) | ((kind >= ends[1]) & (kind < ends[2]))
        commands = commands.masked_fill(torch.stack([no_speed, no_yaw_rate], -1), 0.0)
        return commands, self.cell_of(commands)

    def update(self, weights: Tensor, cells: Tensor) -> Tensor:
        """Compute P_{K+1} from P_K: each success adds the increment to its neighbourhood, saturating at 1.

        A cell named twice counts twice; weights never fall.

        Args:
            weights: ``shape``.
            cells: int64 ``(n,)``, the flat index of each success.

        Returns:
            New weights, ``shape``.
        """
        counts = torch.bincount(cells, minlength=weights.numel()).reshape(1, 1, *self.shape).double()
        kernel = counts.new_ones(1, 1, *(2 * r + 1 for r in self.radius))
        if self.count_own_twice:
            kernel[..., self.radius[0], self.radius[1]] += 1
        gain = functional.conv2d(counts, kernel, padding=self.radius)[0, 0]
        return self._allowed((weights.double() + self.increment * gain).clamp(max=1.0).to(weights.dtype))

    def merge(self, weights: Tensor, other: Tensor) -> Tensor:
        """Return the elementwise maximum of two workers' weights, which only ever rise."""
        return torch.maximum(weights, other)

    def area(self, weights: Tensor) -> tuple[float, float]:
        """Return the weighted area: as a fraction of the cells that may be drawn, and in (m/s)(rad/s), edges cut."""
        low, high = self._edges(torch.arange(weights.numel(), device=weights.device))
        sizes = (high - low).prod(-1).reshape(self.shape)
        weights, cells_drawn = weights.double(), self._allowed(torch.ones_like(weights)).sum()
        return float(weights.sum() / cells_drawn), float((weights * sizes).sum())

    def frontier(self, weights: Tensor) -> tuple[float, float]:
        """Return the largest ``|c_v|`` (m/s) and ``|c_omega|`` (rad/s) that can be drawn."""
        low, high = self._edges((weights.reshape(-1) > 0).nonzero()[:, 0])
        reach = torch.maximum(low.abs(), high.abs()).amax(0)
        return round(float(reach[0]), 9), round(float(reach[1]), 9)


@cache
def _all_edges(grid: CommandGrid, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the lowest and highest command of all cells; cached, as most steps of many robots draw commands."""
    centres = grid.centres(torch.arange(math.prod(grid.shape), device=device))
    reach = torch.tensor(grid.bin_size, dtype=torch.float64, device=device) / 2
    bound = torch.tensor(grid.bounds, dtype=torch.float64, device=device)
    low = torch.maximum(centres - reach, -bound)
    if grid.forward_only:
        low[:, 0].clamp_(min=0.0)
    return low, torch.minimum(centres + reach, bound)

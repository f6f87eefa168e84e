"""Networks that are left-right symmetric by construction.

A robot and its mirror image obey the same physics: the reflected action of one is optimal for the other. A network
whose weights are tied accordingly acts alike to the left and to the right, and learns from every step about both.

A reflection of an entry is a signed permutation matrix R, (D, D) with R R = 1: the mirror image of x is R x.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import MLP


def check_reflection(reflection: Tensor, features: int, name: str = "a reflection") -> Tensor:
    """Return ``reflection`` if it is a valid one of ``features`` components, as (D, D) in the default dtype.

    Raises:
        ValueError: if it is not a signed permutation that undoes itself.

    Example:
        >>> check_reflection(torch.tensor([[0, 1], [1, 0]]), 2)
        tensor([[0., 1.],
                [1., 0.]])
    """
    matrix = reflection.to(torch.get_default_dtype())
    one = torch.eye(features).to(matrix)
    sizes = matrix.abs()
    permutes = torch.equal(sizes, sizes.round()) and bool((sizes.sum(-1) == 1).all())
    if matrix.shape != one.shape or not permutes or not torch.equal(matrix @ matrix, one):
        raise ValueError(
            f"{name} must be a signed permutation matrix of {features} components that is its own inverse, got one of "
            f"shape {tuple(reflection.shape)}"
        )
    return matrix


def halves_swapped(features: int) -> Tensor:
    """Return the reflection of hidden units in left and right halves, (features, features).

    Raises:
        ValueError: for an odd number.

    Example:
        >>> halves_swapped(2)
        tensor([[0., 1.],
                [1., 0.]])
    """
    if features % 2:
        raise ValueError(f"a symmetric layer needs an even number of units, got {features}")
    return torch.eye(features).roll(features // 2, 0)


class EquivariantLinear(nn.Module):
    """Linear layer with f(R x) = S f(x) for reflections R of its inputs and S of its outputs.

    It maps the even part of its inputs, x + R x, to the even part of its outputs and the odd part, x - R x, to the odd
    one: two small layers with half the weights and, between hidden units, half the products of a plain layer.

    Args:
        inputs (Tensor): R, (in_features, in_features).
        outputs (Tensor): S, (out_features, out_features).

    Raises:
        ValueError: if either is not a reflection.

    Example:
        >>> layer = EquivariantLinear(torch.diag(torch.tensor([1.0, -1.0])), halves_swapped(4))
        >>> x = torch.tensor([2.0, 3.0])
        >>> bool(torch.allclose(layer(x * torch.tensor([1.0, -1.0])), layer(x).roll(2), atol=1e-6))
        True
    """

    def __init__(self, inputs: Tensor, outputs: Tensor) -> None:
        super().__init__()
        self.in_features, self.out_features = len(inputs), len(outputs)
        self.inputs, self.outputs = _parity(inputs), _parity(outputs)
        self.even = self._block(self.inputs.num_even, self.outputs.num_even, bias=True)
        self.odd = self._block(self.inputs.num_odd, self.outputs.num_odd, bias=False)  # a constant has no odd part

    def _block(self, inputs: int, outputs: int, bias: bool) -> nn.Linear | None:
        """Return a layer between parts of one parity, initialised like a plain one; None if a part is empty."""
        if not inputs or not outputs:
            return None
        layer = nn.Linear(inputs, outputs, bias)
        with torch.no_grad():
            layer.weight.div_(self.inputs.gain * self.outputs.gain)
            if bias:
                layer.bias.div_(self.outputs.gain)
        return layer

    def forward(self, x: Tensor) -> Tensor:
        """Map (*B, in_features) to (*B, out_features)."""
        even, odd = self.inputs.split(x)
        parts = _apply(self.even, even, self.outputs.num_even), _apply(self.odd, odd, self.outputs.num_odd)
        return self.outputs.join(*parts)

    def extra_repr(self) -> str:
        """Return the sizes for ``repr``, in the format of ``nn.Linear``."""
        return f"in_features={self.in_features}, out_features={self.out_features}"


def _apply(block: nn.Linear | None, x: Tensor, features: int) -> Tensor:
    return x.new_zeros(*x.shape[:-1], features) if block is None else block(x)


class _Halves(nn.Module):
    """Even and odd parts of units whose left ones, in the first half, have right partners in the second."""

    gain = math.sqrt(2.0)
    """Scale of both parts relative to the units."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.num_even = self.num_odd = features // 2

    def split(self, x: Tensor) -> tuple[Tensor, Tensor]:
        left, right = x.chunk(2, -1)
        return left + right, left - right

    def join(self, even: Tensor, odd: Tensor) -> Tensor:
        return torch.cat([even + odd, even - odd], -1)


class _Parity(nn.Module):
    """Even and odd parts under any reflection, by orthonormal bases of its eigenspaces."""

    gain = 1.0
    basis: Tensor

    def __init__(self, reflection: Tensor) -> None:
        super().__init__()
        one = torch.eye(len(reflection))
        first = reflection.abs().argmax(-1) >= torch.arange(len(reflection))  # of a swapped pair
        even, odd = (_unit_columns((one + sign * reflection)[:, first]) for sign in (1, -1))
        self.num_even, self.num_odd = even.shape[1], odd.shape[1]
        # saved with the weights, which depend on the basis
        self.register_buffer("basis", torch.cat([even, odd], 1))

    def split(self, x: Tensor) -> tuple[Tensor, Tensor]:
        even, odd = (x @ self.basis).split([self.num_even, self.num_odd], -1)
        return even, odd

    def join(self, even: Tensor, odd: Tensor) -> Tensor:
        return torch.cat([even, odd], -1) @ self.basis.T


def _unit_columns(matrix: Tensor) -> Tensor:
    """Return the non-zero columns of a matrix, at unit length."""
    length = matrix.norm(dim=0)
    return matrix[:, length > 0] / length[length > 0]


def _parity(reflection: Tensor) -> _Halves | _Parity:
    matrix, size = check_reflection(reflection, len(reflection)), len(reflection)
    swaps_halves = size % 2 == 0 and torch.equal(matrix, halves_swapped(size))
    return _Halves(size) if swaps_halves else _Parity(matrix)


def join_reflections(*parts: Tensor | None) -> Tensor:
    """Return the reflection of concatenated entries, (D, D) for D components in all.

    Raises:
        ValueError: if one is None: the reflection of a part is unknown.

    Example:
        >>> join_reflections(torch.eye(1), -torch.eye(1)).diagonal()
        tensor([ 1., -1.])
    """
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        raise ValueError("a symmetric network needs the reflection of every input; give its normaliser one too")
    return torch.block_diag(*known)


def make_mlp(
    in_features: int, out_features: int, cells: Sequence[int], reflections: tuple[Tensor, Tensor] | None
) -> nn.Module:
    """Return an MLP with ELU between its layers: TorchRL's, or a symmetric one if there are reflections.

    Example:
        >>> make_mlp(3, 1, [8], None)(torch.zeros(2, 3)).shape
        torch.Size([2, 1])
    """
    if reflections is None:
        return MLP(in_features, out_features, num_cells=list(cells), activation_class=nn.ELU)
    return equivariant_mlp(*reflections, cells)


def equivariant_mlp(inputs: Tensor, outputs: Tensor, cells: Sequence[int]) -> nn.Sequential:
    """Return an MLP with ELU between its layers that commutes with reflections.

    Args:
        inputs (Tensor): of its inputs, (D, D).
        outputs (Tensor): of its outputs.
        cells (sequence of int): hidden widths, even, one at least.

    Raises:
        ValueError: for an odd width, for none, or a matrix that is not a reflection.

    Example:
        >>> equivariant_mlp(torch.eye(3), torch.eye(1), [8, 4])(torch.zeros(2, 3)).shape
        torch.Size([2, 1])
    """
    *hidden, last = itertools.pairwise([inputs, *(halves_swapped(cell) for cell in cells), outputs])
    activated = ((EquivariantLinear(*pair), nn.ELU()) for pair in hidden)
    return nn.Sequential(*itertools.chain.from_iterable(activated), EquivariantLinear(*last))

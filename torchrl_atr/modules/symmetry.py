"""Networks that are left-right symmetric by construction.

A robot and its mirror image are the same robot: what is right for one is right, reflected, for the other. A network
whose weights are tied accordingly cannot lean left better than right, and learns from every step about both.

A reflection of an entry is a signed permutation matrix R, (D, D) with R R = 1: the mirror image of x is R x.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import MLP


def check_reflection(reflection: Tensor, features: int, name: str = "a reflection") -> Tensor:
    """Return ``reflection`` if it is one of ``features`` components, as (D, D) in the default dtype.

    Raises:
        ValueError: if it is not a signed permutation that undoes itself.

    Examples:
        >>> check_reflection(torch.tensor([[0, 1], [1, 0]]), 2)
        tensor([[0., 1.],
                [1., 0.]])
    """
    matrix = reflection.to(torch.get_default_dtype())
    one = torch.eye(features).to(matrix)
    if matrix.shape != one.shape or not torch.equal(matrix @ matrix, one) or not torch.equal(matrix, matrix.round()):
        raise ValueError(
            f"{name} must be a signed permutation matrix of {features} components that is its own inverse, got one of "
            f"shape {tuple(reflection.shape)}"
        )
    return matrix


def halves_swapped(features: int) -> Tensor:
    """The reflection of hidden units of which every left one has a right one, (features, features).

    Raises:
        ValueError: for an odd number.

    Examples:
        >>> halves_swapped(2)
        tensor([[0., 1.],
                [1., 0.]])
    """
    if features % 2:
        raise ValueError(f"a symmetric layer needs an even number of units, got {features}")
    return torch.eye(features).roll(features // 2, 0)


class SymmetricLinear(nn.Module):
    """A linear layer with f(R x) = S f(x) for reflections R of its inputs and S of its outputs.

    One of the two swaps the halves of hidden units (:func:`halves_swapped`), as every layer of :func:`symmetric_mlp`
    has it. Then half of the weights are free and the others are their mirror image: [A, S A] where the inputs swap
    halves, [A; A R] where the outputs do.

    Args:
        inputs (Tensor): R, (in_features, in_features).
        outputs (Tensor): S, (out_features, out_features).

    Raises:
        ValueError: if either is no reflection, or neither swaps halves.

    Examples:
        >>> layer = SymmetricLinear(torch.diag(torch.tensor([1.0, -1.0])), halves_swapped(4))
        >>> x = torch.tensor([2.0, 3.0])
        >>> bool(torch.allclose(layer(x * torch.tensor([1.0, -1.0])), layer(x).roll(2), atol=1e-6))
        True
    """

    order: Tensor
    signs: Tensor
    out_order: Tensor
    out_signs: Tensor

    def __init__(self, inputs: Tensor, outputs: Tensor) -> None:
        super().__init__()
        self.in_features, self.out_features = len(inputs), len(outputs)
        inputs, outputs = (check_reflection(matrix, len(matrix)) for matrix in (inputs, outputs))
        self.beside = _swaps_halves(inputs)  # the mirror image stands beside the free weights, else below them
        if not self.beside and not _swaps_halves(outputs):
            raise ValueError("a symmetric layer needs inputs or outputs whose reflection swaps halves")
        free = nn.Linear(self.in_features, self.out_features)  # for its initial values
        half = free.weight.chunk(2, 1 if self.beside else 0)[0]
        self.weight, self.bias = nn.Parameter(half.detach().clone()), free.bias
        for name, matrix in (("", outputs if self.beside else inputs), ("out_", outputs)):
            order = matrix.abs().argmax(-1)
            # saved with the weights, which mean something else to a plain layer
            self.register_buffer(f"{name}order", order)
            self.register_buffer(f"{name}signs", matrix.gather(-1, order[:, None])[:, 0])

    def forward(self, x: Tensor) -> Tensor:
        """Map (*B, in_features) to (*B, out_features)."""
        if self.beside:
            mirrored = self.weight.index_select(0, self.order) * self.signs[:, None]
        else:
            mirrored = self.weight.index_select(1, self.order) * self.signs
        weight = torch.cat([self.weight, mirrored], 1 if self.beside else 0)
        bias = (self.bias + self.out_signs * self.bias[self.out_order]) / 2
        return nn.functional.linear(x, weight, bias)

    def extra_repr(self) -> str:
        """As ``nn.Linear`` shows itself."""
        return f"in_features={self.in_features}, out_features={self.out_features}"


def _swaps_halves(reflection: Tensor) -> bool:
    size = len(reflection)
    return size % 2 == 0 and torch.equal(reflection, halves_swapped(size))


def join_reflections(*parts: Tensor | None) -> Tensor:
    """The reflection of entries that stand side by side, (D, D) for D components in all.

    Raises:
        ValueError: if one is None: the mirror image of a part is not known.

    Examples:
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
    """An MLP with ELU between its layers: TorchRL's, or a symmetric one where inputs and outputs have reflections.

    Examples:
        >>> make_mlp(3, 1, [8], None)(torch.zeros(2, 3)).shape
        torch.Size([2, 1])
    """
    if reflections is None:
        return MLP(in_features, out_features, num_cells=list(cells), activation_class=nn.ELU)
    return symmetric_mlp(*reflections, cells)


def symmetric_mlp(inputs: Tensor, outputs: Tensor, cells: Sequence[int]) -> nn.Sequential:
    """An MLP with ELU between its layers that commutes with reflections.

    Args:
        inputs (Tensor): of its inputs, (D, D).
        outputs (Tensor): of its outputs.
        cells (sequence of int): hidden widths, even, one at least.

    Raises:
        ValueError: for an odd width, for none, or a matrix that is no reflection.

    Examples:
        >>> symmetric_mlp(torch.eye(3), torch.eye(1), [8, 4])(torch.zeros(2, 3)).shape
        torch.Size([2, 1])
    """
    *hidden, last = itertools.pairwise([inputs, *(halves_swapped(cell) for cell in cells), outputs])
    activated = ((SymmetricLinear(*pair), nn.ELU()) for pair in hidden)
    return nn.Sequential(*itertools.chain.from_iterable(activated), SymmetricLinear(*last))

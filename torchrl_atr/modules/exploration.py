"""Standard deviations and directions of a Gaussian policy's exploration (theta_std)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from scipy.linalg import hadamard
from torch import Tensor, nn


class Exploration(nn.Module):
    """Learned standard deviation for each direction of exploration, with a floor (the paper's theta_std).

    It depends on no input and changes no mean action. ``std = min_std + softplus(raw)``: unlike a clamp, which has
    no gradient below the floor and so keeps an action there for good, softplus lets exploration grow again from any
    value. A recipe may anneal it with :meth:`cap_` between iterations.

    Args:
        actions (int): number of actions, A.
        init_std (float or sequence of float): initial standard deviation, or one for each direction, in units of the
            action. Defaults to 0.3.
        min_std (float): floor, in units of the action. Defaults to 0.05.
        basis (Tensor, optional): directions of exploration, (A, A), orthonormal columns, such as
            :func:`~torchrl_atr.modules.hadamard_leg_basis`. None, the default, explores each action by itself.

    Attributes:
        raw (Parameter): the learned parameters, (A,).
        basis (Tensor or None): the directions, in the default dtype.

    Raises:
        ValueError: unless ``0 <= min_std < init_std``, for another number of values than one or ``actions``, and for a
            basis whose columns are not orthonormal.

    Example:
        >>> exploration = Exploration(2, init_std=0.3)
        >>> exploration.std().tolist()
        [0.30000001192092896, 0.30000001192092896]
        >>> exploration.cap_(0.1)
        >>> round(exploration.std().max().item(), 4)
        0.1
    """

    basis: Tensor | None

    def __init__(
        self,
        actions: int,
        init_std: float | Sequence[float] = 0.3,
        min_std: float = 0.05,
        basis: Tensor | None = None,
    ) -> None:
        super().__init__()
        initial = torch.as_tensor(init_std, dtype=torch.get_default_dtype())
        if initial.numel() not in (1, actions):
            raise ValueError(f"init_std needs one value or {actions}, got {initial.numel()}.")
        if not 0.0 <= min_std < float(initial.min()):
            raise ValueError(f"Need 0 <= min_std < init_std, got min_std={min_std}, init_std={init_std}.")
        self.min_std = float(min_std)
        self.raw = nn.Parameter(torch.expm1(initial - min_std).log().expand(actions).clone())
        self.register_buffer("basis", None if basis is None else check_basis(basis, actions))

    def std(self) -> Tensor:
        """Return the standard deviation along each direction, (A,), in units of the action."""
        return self.min_std + nn.functional.softplus(self.raw)

    def forward(self, loc: Tensor) -> Tensor:
        """Return :meth:`std` for every mean action, (*B, A) for ``loc`` of that shape."""
        return self.std().expand_as(loc)

    @torch.no_grad()
    def cap_(self, ceiling: float) -> None:
        """Lower every standard deviation above ``ceiling`` to it; unlike under a clamp, gradients keep flowing.

        Args:
            ceiling (float): in units of the action.

        Raises:
            ValueError: unless ``ceiling`` is above the floor.
        """
        if not ceiling > self.min_std:
            raise ValueError(f"ceiling must be above min_std={self.min_std}, got {ceiling}.")
        self.raw.clamp_(max=math.log(math.expm1(ceiling - self.min_std)))


def hadamard_leg_basis(joints: int = 3) -> Tensor:
    """Return orthonormal directions in which four legs move together or against each other.

    The columns are the four Hadamard patterns over the legs (common; then two legs against two, in three ways) for each
    joint of a leg. The first ``joints`` columns move all legs alike: they lean, shift and lift the body, which
    tilts a board; independent noise in twelve joints mostly makes the legs act against each other.

    Args:
        joints (int): joints of a leg; the actions are listed leg by leg, the legs in any order.

    Returns:
        Tensor: (4 * joints, 4 * joints), orthonormal columns.

    Example:
        >>> hadamard_leg_basis(1)[:, 0].tolist()
        [0.5, 0.5, 0.5, 0.5]
    """
    patterns = torch.as_tensor(hadamard(4), dtype=torch.get_default_dtype()) / 2
    return torch.kron(patterns, torch.eye(joints))


def check_basis(basis: Tensor, actions: int) -> Tensor:
    """Return ``basis`` in the default dtype if its columns are orthonormal.

    Args:
        basis (Tensor): (actions, actions).
        actions (int): number of actions.

    Raises:
        ValueError: if the shape is another one, or the columns are not orthonormal.

    Example:
        >>> check_basis(torch.eye(2), 2).shape
        torch.Size([2, 2])
    """
    basis = basis.to(torch.get_default_dtype())
    if basis.shape != (actions, actions) or not torch.allclose(basis.T @ basis, torch.eye(actions), atol=1e-5):
        raise ValueError(
            f"basis needs {actions} orthonormal columns of {actions}, got {tuple(basis.shape)}; hadamard_leg_basis() "
            "is one."
        )
    return basis

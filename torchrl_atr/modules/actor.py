"""The actor backbone of Table I (pi^a) and its state-independent exploration (theta_std)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from torchrl_atr.modules.exploration import SynergyNormal, check_basis
from torchrl_atr.modules.keys import NetworkKeys
from torchrl_atr.modules.normalization import RunningNormalizer
from torchrl_atr.modules.symmetry import check_reflection, halves_swapped, join_reflections, make_mlp


class StateIndependentStd(nn.Module):
    """One learned standard deviation per action, never below a floor (the paper's theta_std).

    ``std = min_std + softplus(raw)``: unlike a clamp, which has no gradient below the floor and so keeps an
    action there for good, softplus lets exploration grow again from any value. A recipe may anneal the
    exploration with :meth:`cap_` between iterations.

    Args:
        features (int): number of actions.
        init_std (float or sequence of float): initial value, or one for each action, in units of the action.
            Defaults to 0.3.
        min_std (float): floor. Defaults to 0.05.

    Raises:
        ValueError: unless ``0 <= min_std < init_std``, or for another number of values than ``features``.

    Examples:
        >>> StateIndependentStd(2)().tolist()
        [0.30000001192092896, 0.30000001192092896]
    """

    def __init__(self, features: int, init_std: float | Sequence[float] = 0.3, min_std: float = 0.05) -> None:
        super().__init__()
        initial = torch.as_tensor(init_std, dtype=torch.get_default_dtype())
        if initial.numel() not in (1, features):
            raise ValueError(f"init_std needs one value or {features}, got {initial.numel()}.")
        if not 0.0 <= min_std < float(initial.min()):
            raise ValueError(f"Need 0 <= min_std < init_std, got min_std={min_std}, init_std={init_std}.")
        self.min_std = float(min_std)
        self.raw = nn.Parameter(torch.expm1(initial - min_std).log().expand(features).clone())

    def forward(self) -> Tensor:
        """Return the standard deviations, (features,)."""
        return self.min_std + nn.functional.softplus(self.raw)

    @torch.no_grad()
    def cap_(self, ceiling: float) -> None:
        """Lower every std above ``ceiling`` to it; the gradient keeps flowing, unlike under a clamp.

        Raises:
            ValueError: unless ``ceiling`` is above the floor.
        """
        if not ceiling > self.min_std:
            raise ValueError(f"ceiling must be above min_std={self.min_std}, got {ceiling}.")
        self.raw.clamp_(max=math.log(math.expm1(ceiling - self.min_std)))


PRODUCT_SCALE = 4.0
"""Adam moves every weight alike: an input four times as large is learned four times as fast."""


class ActorBackbone(nn.Module):
    """Map what the robot senses and what it knows or estimates to an action distribution (Table I, pi^a).

    The observation and the extrinsic state are normalised inside; the latent is not (it has the encoder's
    scale).

    Args:
        observation_norm, extrinsic_norm (RunningNormalizer): shared with critic and estimators.
        latent_features (int): size of the latent.
        action_features (int): number of actions.
        cells (sequence of int): hidden widths. Defaults to ``(512, 256, 128)``.
        init_std, min_std (float): see :class:`StateIndependentStd`.
        noise_basis (Tensor, optional): orthonormal columns, (A, A), along which the actions are explored
            independently, such as :func:`~torchrl_atr.modules.leg_synergies`; None for the actions themselves.
        products (sequence of pairs of int): for every ``(i, j)`` the network also reads ``tanh(x_i) * x_j`` of the
            normalised observation x, times :data:`PRODUCT_SCALE`. A board turns by the product of two tilts, so
            the lean that answers a yaw command changes sign with the speed command: an exclusive-or, of which a
            gradient at first sees nothing.
        reflection (Tensor, optional): of the action, (A, A). The mean action of a mirrored robot is then the mirrored
            mean action; both normalisers need a reflection, and the latent's is a swap of its halves, as
            :class:`~torchrl_atr.modules.IntrinsicEncoder` makes it.

    Raises:
        ValueError: for a product of entries that the observation does not have, and for a reflection that is none,
            or that does not map each column of the noise basis and each product to itself or its negative.

    Examples:
        >>> import torch
        >>> backbone = ActorBackbone(RunningNormalizer(5), RunningNormalizer(4), 3, 2)
        >>> loc, scale = backbone(torch.zeros(7, 5), torch.zeros(7, 3), torch.zeros(7, 4))
        >>> loc.shape, scale.shape
        (torch.Size([7, 2]), torch.Size([7, 2]))
    """

    _gates: Tensor
    _gated: Tensor

    def __init__(
        self,
        observation_norm: RunningNormalizer,
        extrinsic_norm: RunningNormalizer,
        latent_features: int,
        action_features: int,
        cells: Sequence[int] = (512, 256, 128),
        init_std: float | Sequence[float] = 0.3,
        min_std: float = 0.05,
        noise_basis: Tensor | None = None,
        products: Sequence[tuple[int, int]] = (),
        reflection: Tensor | None = None,
    ) -> None:
        super().__init__()
        size = observation_norm.shape.numel()
        if any(not 0 <= index < size for pair in products for index in pair):
            raise ValueError(f"products={list(products)} names entries beyond the observation's {size}.")
        pairs = torch.tensor(products, dtype=torch.long).reshape(-1, 2)
        self.register_buffer("_gates", pairs[:, 0], persistent=False)  # where the input is: lists would be sent there
        self.register_buffer("_gated", pairs[:, 1], persistent=False)
        basis = check_basis(torch.eye(action_features) if noise_basis is None else noise_basis, action_features)
        self.register_buffer("noise_basis", basis)
        # Adam's steps are alike in all outputs. In units of the exploration's variance, a column's share of the
        # divergence follows what its exploration can teach: what is explored little does not use up the trust region.
        exploration = StateIndependentStd(action_features, init_std, min_std)
        std = torch.as_tensor(init_std, dtype=basis.dtype).expand(action_features)
        self.register_buffer("head", ((std.square() / std.max()).unsqueeze(-1) * basis.T).contiguous())
        self.observation_norm = observation_norm
        self.extrinsic_norm = extrinsic_norm
        in_features = size + len(products) + latent_features + extrinsic_norm.shape.numel()
        reflections = None
        if reflection is not None:
            along_basis = basis.T @ check_reflection(reflection, action_features, "the action's reflection") @ basis
            reflections = self._input_reflection(latent_features), along_basis.round(decimals=4)
        self.net = make_mlp(in_features, action_features, cells, reflections)
        self.std = exploration

    def _input_reflection(self, latent_features: int) -> Tensor:
        observation = join_reflections(self.observation_norm.reflection)
        signs = observation.diagonal()
        products = torch.diag(signs[self._gates] * signs[self._gated])
        return join_reflections(observation, products, halves_swapped(latent_features), self.extrinsic_norm.reflection)

    def forward(self, observation: Tensor, intrinsic: Tensor, extrinsic: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``loc`` and ``scale``, each (*B, A), from (*B, O), (*B, L) and (*B, E) (SI units).

        ``scale`` is along the columns of the noise basis.
        """
        x = self.observation_norm(observation)
        products = PRODUCT_SCALE * x[..., self._gates].tanh() * x[..., self._gated]
        inputs = (x, products, intrinsic, self.extrinsic_norm(extrinsic))
        loc = self.net(torch.cat(inputs, -1)) @ self.head
        return loc, self.std().expand_as(loc)


def make_actor(
    backbone: ActorBackbone,
    *front: TensorDictModuleBase,
    observation: NestedKey = NetworkKeys.observation,
    act_intrinsic: NestedKey = NetworkKeys.act_intrinsic,
    act_extrinsic: NestedKey = NetworkKeys.act_extrinsic,
    action: NestedKey = NetworkKeys.action,
) -> ProbabilisticActor:
    """Put modules that produce the act entries before a backbone and sample an action after it.

    Args:
        backbone (ActorBackbone): shared by every actor made from it.
        *front (TensorDictModuleBase): run first, in order: encoder, estimators, act source.
        observation (NestedKey): read by the backbone.
        act_intrinsic (NestedKey): read by the backbone, written by the front.
        act_extrinsic (NestedKey): the same.
        action (NestedKey): what is written, with ``<action>_log_prob`` beside it.

    Returns:
        ProbabilisticActor: a Gaussian policy (:class:`~torchrl_atr.modules.SynergyNormal` along the backbone's
            noise basis).

    Examples:
        >>> backbone = ActorBackbone(RunningNormalizer(5), RunningNormalizer(4), 3, 2)
        >>> make_actor(backbone).in_keys
        ['observation', ('act', 'intrinsic'), ('act', 'extrinsic')]
    """
    in_keys = [observation, act_intrinsic, act_extrinsic]
    head = TensorDictModule(backbone, in_keys=in_keys, out_keys=["loc", "scale"])
    return ProbabilisticActor(
        TensorDictSequential(*front, head) if front else head,
        in_keys=["loc", "scale"],
        out_keys=[action],
        distribution_class=SynergyNormal,
        distribution_kwargs={"basis": backbone.noise_basis},
        return_log_prob=True,
    )

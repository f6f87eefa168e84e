"""The actor backbone of Table I (pi^a) and its state-independent exploration (theta_std)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor

from torchrl_atr.modules.keys import NetworkKeys
from torchrl_atr.modules.normalization import RunningNormalizer


class StateIndependentStd(nn.Module):
    """One learned standard deviation per action, never below a floor (the paper's theta_std).

    ``std = min_std + softplus(raw)``: unlike a clamp, which has no gradient below the floor and so keeps an
    action there for good, softplus lets exploration grow again from any value. A recipe may lower ``ceiling``
    between iterations to anneal the exploration; while it binds, the std follows it and not its gradient.

    Attributes:
        ceiling (Tensor): what no std exceeds, a scalar buffer; infinite unless lowered.

    Args:
        features (int): number of actions.
        init_std (float): initial value, in units of the action. Defaults to 0.3.
        min_std (float): floor. Defaults to 0.05.

    Raises:
        ValueError: unless ``0 <= min_std < init_std``.

    Examples:
        >>> StateIndependentStd(2)().tolist()
        [0.30000001192092896, 0.30000001192092896]
    """

    def __init__(self, features: int, init_std: float = 0.3, min_std: float = 0.05) -> None:
        super().__init__()
        if not 0.0 <= min_std < init_std:
            raise ValueError(f"Need 0 <= min_std < init_std, got min_std={min_std}, init_std={init_std}.")
        self.min_std = float(min_std)
        raw = math.log(math.expm1(init_std - min_std))
        self.raw = nn.Parameter(torch.full((features,), raw))
        self.register_buffer("ceiling", torch.tensor(math.inf))

    ceiling: Tensor

    def forward(self) -> Tensor:
        """Return the standard deviations, (features,)."""
        return (self.min_std + nn.functional.softplus(self.raw)).clamp_max(self.ceiling)


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

    Examples:
        >>> import torch
        >>> backbone = ActorBackbone(RunningNormalizer(5), RunningNormalizer(4), 3, 2)
        >>> loc, scale = backbone(torch.zeros(7, 5), torch.zeros(7, 3), torch.zeros(7, 4))
        >>> loc.shape, scale.shape
        (torch.Size([7, 2]), torch.Size([7, 2]))
    """

    def __init__(
        self,
        observation_norm: RunningNormalizer,
        extrinsic_norm: RunningNormalizer,
        latent_features: int,
        action_features: int,
        cells: Sequence[int] = (512, 256, 128),
        init_std: float = 0.3,
        min_std: float = 0.05,
    ) -> None:
        super().__init__()
        self.observation_norm = observation_norm
        self.extrinsic_norm = extrinsic_norm
        in_features = observation_norm.shape.numel() + latent_features + extrinsic_norm.shape.numel()
        self.net = MLP(in_features, action_features, num_cells=list(cells), activation_class=nn.ELU)
        self.std = StateIndependentStd(action_features, init_std, min_std)

    def forward(self, observation: Tensor, intrinsic: Tensor, extrinsic: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``loc`` and ``scale``, each (*B, A), from (*B, O), (*B, L) and (*B, E) (SI units)."""
        inputs = (self.observation_norm(observation), intrinsic, self.extrinsic_norm(extrinsic))
        loc = self.net(torch.cat(inputs, -1))
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
        ProbabilisticActor: a diagonal Gaussian policy (:class:`~torchrl.modules.IndependentNormal`).

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
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )

"""Asymmetric critic (question A20), with privileged inputs, since only the actor is deployed."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchrl_atr.modules.normalization import RunningNormalizer
from torchrl_atr.modules.symmetry import join_reflections, make_mlp


class AsymmetricCritic(nn.Module):
    """Value network of the full state: observation, intrinsic parameters, extrinsic state (question A20), others.

    It has its own MLP and shares only the (frozen between updates) normalisers with the actor.

    Args:
        observation_norm (RunningNormalizer): of the observation, (O,); shared with the actor.
        extrinsic_norm (RunningNormalizer, optional): of the extrinsic state, (E,); shared with the actor. None for a
            critic that reads nothing privileged, and is not asymmetric then.
        intrinsic_features (int): I, the size of ``("privileged", "intrinsic")``, scaled to [-1, 1] by the env.
        cells (sequence of int): hidden widths. Defaults to ``(512, 256, 128)``.
        input_norms (sequence of RunningNormalizer): of further inputs, one for each. Defaults to none.
        scale (float): multiplies the output, so that a fresh network need not grow to the size of returns
            of some tens. Defaults to 10.
        intrinsic_reflection (Tensor, optional): of the intrinsic parameters, (I, I); where the normalisers have
            reflections too, a state and its mirror image have the same value.

    Raises:
        ValueError: if some of the inputs have a reflection and others have none.

    Example:
        >>> import torch
        >>> critic = AsymmetricCritic(RunningNormalizer(5), RunningNormalizer(4), 6)
        >>> critic(torch.zeros(7, 5), torch.zeros(7, 6), torch.zeros(7, 4)).shape
        torch.Size([7, 1])
    """

    def __init__(
        self,
        observation_norm: RunningNormalizer,
        extrinsic_norm: RunningNormalizer | None = None,
        intrinsic_features: int = 0,
        cells: Sequence[int] = (512, 256, 128),
        input_norms: Sequence[RunningNormalizer] = (),
        scale: float = 10.0,
        intrinsic_reflection: Tensor | None = None,
    ) -> None:
        super().__init__()
        self.scale = float(scale)
        self.observation_norm = observation_norm
        self.extrinsic_norm = extrinsic_norm
        self.input_norms = nn.ModuleList(input_norms)
        norms = [*([] if extrinsic_norm is None else [extrinsic_norm]), *input_norms]
        in_features = intrinsic_features + sum(norm.shape.numel() for norm in (observation_norm, *norms))
        reflections = None
        if observation_norm.reflection is not None:
            privileged = [intrinsic_reflection] if intrinsic_features else []
            parts = [observation_norm.reflection, *privileged, *(norm.reflection for norm in norms)]
            reflections = join_reflections(*parts), torch.eye(1)
        self.net = make_mlp(in_features, 1, cells, reflections)

    def forward(self, observation: Tensor, *others: Tensor) -> Tensor:
        """Return the value, (*B, 1).

        Args:
            observation (Tensor): (*B, O), raw, as all of them.
            *others (Tensor): (*B, I) and (*B, E), unless there is no ``extrinsic_norm``, then one for each of
                ``input_norms``.
        """
        inputs = [self.observation_norm(observation)]
        if self.extrinsic_norm is not None:
            intrinsic, extrinsic, *others = others  # type: ignore[assignment]
            inputs += [intrinsic, self.extrinsic_norm(extrinsic)]
        inputs += [norm(value) for norm, value in zip(self.input_norms, others)]
        return self.scale * self.net(torch.cat(inputs, -1))

"""Intrinsic encoder of Table I (pi^enc)."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from torchrl_atr.modules.symmetry import halves_swapped, make_mlp


class IntrinsicEncoder(nn.Module):
    """Network from the intrinsic parameters to the latent z (Table I, ``x_int -> [128, 64] -> z``).

    ELU between layers, no activation on the output. The input is already scaled to [-1, 1], so it is not
    normalised.

    Args:
        in_features (int): size of ``("privileged", "intrinsic")``.
        out_features (int): size of the latent. Defaults to 16.
        hidden (sequence of int): hidden widths. Defaults to ``(128, 64)``.
        reflection (Tensor, optional): of the input, (in_features, in_features): the latent of the robot's mirror image
            is then the latent with its halves swapped.

    Example:
        >>> import torch
        >>> IntrinsicEncoder(34)(torch.zeros(2, 34)).shape
        torch.Size([2, 16])
    """

    def __init__(
        self,
        in_features: int,
        out_features: int = 16,
        hidden: Sequence[int] = (128, 64),
        reflection: Tensor | None = None,
    ) -> None:
        super().__init__()
        reflections = None if reflection is None else (reflection, halves_swapped(out_features))
        self.net = make_mlp(in_features, out_features, hidden, reflections)

    def forward(self, intrinsic: Tensor) -> Tensor:
        """Map (*B, in_features) to (*B, out_features)."""
        return self.net(intrinsic)

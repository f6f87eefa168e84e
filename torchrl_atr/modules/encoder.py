"""The intrinsic encoder of Table I (pi^enc)."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn
from torchrl.modules import MLP


class IntrinsicEncoder(nn.Module):
    """Encode the intrinsic parameters into the latent z (Table I, ``x_int -> [128, 64] -> z``).

    ELU between layers, no activation on the output. The input is already scaled to [-1, 1], so it is not
    normalised.

    Args:
        in_features (int): size of ``("privileged", "intrinsic")``.
        out_features (int): size of the latent. Defaults to 16.
        hidden (sequence of int): hidden widths. Defaults to ``(128, 64)``.

    Examples:
        >>> import torch
        >>> IntrinsicEncoder(34)(torch.zeros(2, 34)).shape
        torch.Size([2, 16])
    """

    def __init__(self, in_features: int, out_features: int = 16, hidden: Sequence[int] = (128, 64)) -> None:
        super().__init__()
        self.net = MLP(in_features, out_features, num_cells=list(hidden), activation_class=nn.ELU)

    def forward(self, intrinsic: Tensor) -> Tensor:
        """Map (*B, in_features) to (*B, out_features)."""
        return self.net(intrinsic)

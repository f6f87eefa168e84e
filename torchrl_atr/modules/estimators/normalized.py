"""Estimators between normalisers: raw entries in, estimates in the units of their targets out."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchrl_atr.modules.normalization import RunningNormalizer


def beside(history: Tensor, inputs: Sequence[Tensor]) -> Tensor:
    """Return a history (*B, H, D) with further inputs (*B, S) repeated beside each of its observations.

    Example:
        >>> beside(torch.zeros(7, 4, 5), [torch.ones(7, 2)]).shape
        torch.Size([7, 4, 7])
    """
    more = [value.unsqueeze(-2).expand(*history.shape[:-1], -1) for value in inputs]
    return torch.cat([history, *more], -1) if more else history


class NormalizedEstimator(nn.Module):
    """Estimator between normalisers: from a raw history to an estimate in the units of its target.

    Args:
        net (nn.Module): maps (*B, H, D) to (*B, out_features), both normalised; (*B, H, D + S) with side inputs of S
            components in all.
        input_norm (RunningNormalizer): of one observation, (D,); applied to every step of the history.
        output_norm (RunningNormalizer, optional): of the target; its inverse is applied to the output.
            Without it the output is returned as it is.
        side_norms (sequence of RunningNormalizer): of side inputs, one for each, which are appended to every step of
            the history, so that any estimator of histories can read them. Defaults to none.

    Example:
        >>> import torch
        >>> from torchrl_atr.modules.estimators import get_estimator
        >>> estimator = NormalizedEstimator(get_estimator("mlp")((4, 5), 3), RunningNormalizer(5))
        >>> estimator(torch.zeros(2, 4, 5)).shape
        torch.Size([2, 3])
    """

    def __init__(
        self,
        net: nn.Module,
        input_norm: RunningNormalizer,
        output_norm: RunningNormalizer | None = None,
        side_norms: Sequence[RunningNormalizer] = (),
    ) -> None:
        super().__init__()
        self.net = net
        self.input_norm = input_norm
        self.output_norm = output_norm
        self.side_norms = nn.ModuleList(side_norms)

    def forward(self, history: Tensor, *side: Tensor) -> Tensor:
        """Map a raw history (*B, H, D), and side inputs (*B, S_i) if any, to the estimate (*B, out_features)."""
        out = self.net(beside(self.input_norm(history), [norm(value) for norm, value in zip(self.side_norms, side)]))
        return out if self.output_norm is None else self.output_norm.inverse(out)

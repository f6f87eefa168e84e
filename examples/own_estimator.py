"""Example of a custom estimator from outside the package: register it, check it, train with it.

python examples/own_estimator.py
torchrl-atr train --import examples.own_estimator --estimator dilated --max-minutes 5 --output runs/dilated
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from torchrl_atr.modules import check_estimator, register_estimator


class DilatedEstimator(nn.Module):
    """Estimator of three dilated convolutions over the history, averaged over time."""

    def __init__(self, history_shape: tuple[int, int], out_features: int, width: int = 48) -> None:
        super().__init__()
        features = [history_shape[1], width, width, width]
        layers: list[nn.Module] = []
        for i, (before, after) in enumerate(pairwise(features)):
            layers += [nn.Conv1d(before, after, 3, padding=2**i, dilation=2**i), nn.ELU()]
        self.body = nn.Sequential(*layers)
        self.head = nn.Linear(width, out_features)

    def forward(self, history: Tensor) -> Tensor:
        """Map a history (*B, H, D) to estimates (*B, out_features)."""
        flat = history.reshape(-1, *history.shape[-2:]).transpose(-1, -2)
        return (
            self.head(self.body(flat).mean(-1))
            .unflatten(0, history.shape[:-2] or (1,))
            .reshape(*history.shape[:-2], -1)
        )


register_estimator("dilated", DilatedEstimator)

if __name__ == "__main__":
    torch.manual_seed(0)
    check_estimator(DilatedEstimator, history_shape=(10, 46), out_features=16)
    print("dilated: conforms")

"""Tracking kernel of the paper's command rewards (r0 and r1)."""

from __future__ import annotations

import torch
from torch import Tensor

KERNEL_WIDTH = 0.5
"""Width of the tracking kernels, m/s and rad/s."""


def tracking_kernel(error: Tensor, width: float = KERNEL_WIDTH) -> Tensor:
    """Compute exp(-|e| / width): 1 for perfect tracking, any shape.

    Example:
        >>> round(float(tracking_kernel(torch.tensor(-0.5))), 3)
        0.368
    """
    return torch.exp(-error.abs() / width)

"""Mean actions of the step before, for ``loss_smoothness`` of :class:`~torchrl_atr.objectives.ROAClipPPOLoss`."""

from __future__ import annotations

import torch
from torch import Tensor


def previous_means(means: Tensor, done: Tensor) -> Tensor:
    """Return the mean action of the step before in collected batches; if there is none, the mean action itself.

    Args:
        means: mean actions that a rollout recorded, (N, T, A).
        done: whether an episode ended with each step, (N, T, 1) bool.

    Returns:
        (N, T, A); the first step of the batch and of each episode have nothing before them.

    Example:
        >>> means, done = torch.arange(4.0).reshape(1, 4, 1), torch.tensor([[[False], [True], [False], [False]]])
        >>> previous_means(means, done).flatten().tolist()
        [0.0, 0.0, 2.0, 2.0]
    """
    earlier = torch.where(done[:, :-1], means[:, 1:], means[:, :-1])
    return torch.cat([means[:, :1], earlier], 1)


def rms_change(means: Tensor, done: Tensor) -> Tensor:
    """Return the root mean square of the mean actions' changes from step to step within episodes, a scalar.

    Args:
        means: (N, T, A).
        done: whether an episode ended with each step, (N, T, 1) bool.

    Example:
        >>> means, done = torch.tensor([[[0.0], [1.0], [9.0]]]), torch.tensor([[[False], [True], [False]]])
        >>> rms_change(means, done)
        tensor(1.)
    """
    goes_on = ~done[:, :-1]
    change = (means[:, 1:] - means[:, :-1]).square().mean(-1, keepdim=True)
    return ((change * goes_on).sum() / goes_on.sum().clamp_min(1)).sqrt()

"""Delay of joint targets."""

from __future__ import annotations

import torch
from torch import Tensor


class TargetDelay:
    """Queue of joint targets that take effect some substeps after they are given.

    Args:
        delay: in substeps.
        decimation: substeps of a control step, in which targets are given once.
        stand: targets at the start of an episode, rad, (12,).
        num_envs: N.

    Attributes:
        due: number of the substep of a control step at which targets change, from 0.
        queue: the targets in force after that substep and all later ones, side by side, (N, 12 k).

    Example:
        >>> delay = TargetDelay(5, 4, torch.zeros(1), num_envs=1)
        >>> for target in (1.0, 2.0, 3.0):
        ...     delay.give(torch.tensor([[target]]))
        >>> delay.due, delay.current.item()
        (1, 2.0)
    """

    def __init__(self, delay: int, decimation: int, stand: Tensor, num_envs: int) -> None:
        late, self.due = divmod(delay, decimation)
        self._stand = stand
        self.queue = stand.repeat(num_envs, late + 1)

    def give(self, targets: Tensor) -> None:
        """Append the targets of a control step, (N, 12)."""
        self.queue.copy_(torch.cat([self.queue[:, len(self._stand) :], targets], 1))

    def begin(self, rows: Tensor) -> None:
        """Fill the queue of ``rows`` with the stand."""
        self.queue[rows] = self._stand.repeat(len(rows), self.queue.shape[1] // len(self._stand))

    @property
    def current(self) -> Tensor:
        """Targets that take effect in this control step, (N, 12)."""
        return self.queue[:, : len(self._stand)]

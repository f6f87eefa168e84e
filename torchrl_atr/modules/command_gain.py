"""Learned gain of the commands that an actor reads, which removes the steady tracking error of a policy."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class CommandGain(nn.Module):
    """Gain g(c) of the commands in an observation: the actor reads c_i g_i(c) instead of c_i.

    ``g_i = exp(b_i + Σ_j W_ij |c_j| / (1 + |c_j|))``. It is one at first, positive always, and alike for commands of
    either sign, so that a symmetric actor stays symmetric.

    A policy that PPO trains on the tilt of a board settles at three quarters of a commanded speed although it knows
    its error, and asking it for 1.3 times the speed raises the reward by an eighth. The gradient of that direction is
    there, but in a network's weights it is one among thousands that are mostly noise (a signal-to-noise ratio of 0.4
    in 12,288 steps). In C (C + 1) parameters with an optimiser of their own it adds up.

    Args:
        entries (sequence of int): where the C components of the command are in an observation of size O; consecutive.

    Raises:
        ValueError: unless ``entries`` are consecutive.

    Example:
        >>> gain = CommandGain([3, 4])
        >>> gain(torch.tensor([0.1, 0.2, 0.3, 2.0, -1.0]))
        tensor([ 0.1000,  0.2000,  0.3000,  2.0000, -1.0000], grad_fn=<CatBackward0>)
    """

    def __init__(self, entries: Sequence[int]) -> None:
        super().__init__()
        self.start, self.stop = entries[0], entries[0] + len(entries)
        if list(entries) != list(range(self.start, self.stop)):
            raise ValueError(f"entries={list(entries)} of the command must be consecutive")
        self.bias = nn.Parameter(torch.zeros(len(entries)))
        self.weight = nn.Parameter(torch.zeros(len(entries), len(entries)))

    def gain(self, command: Tensor) -> Tensor:
        """Return g for commands in SI units, (*B, C)."""
        size = command.abs()
        return (self.bias + (size / (1 + size)) @ self.weight.T).exp()

    def forward(self, observation: Tensor) -> Tensor:
        """Return the observation (*B, O) with its commands times their gains."""
        before, command, after = observation.tensor_split((self.start, self.stop), -1)
        return torch.cat([before, command * self.gain(command), after], -1)

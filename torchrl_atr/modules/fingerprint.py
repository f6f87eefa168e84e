"""Fingerprint of a deployed policy, by which measurements of it are found again."""

from __future__ import annotations

import hashlib
from typing import Any

import torch


def fingerprint(networks: Any) -> str:
    """Return a hash of all weights and the command range of networks, 16 hexadecimal digits.

    Other state, an estimator's own, does not count.

    Args:
        networks: such as :class:`~torchrl_atr.modules.ROANetworks`.

    Example:
        >>> from types import SimpleNamespace
        >>> one = SimpleNamespace(state_dict=lambda: {"w": torch.ones(2)}, command_range=None)
        >>> fingerprint(one) == fingerprint(SimpleNamespace(**{**vars(one), "command_range": 2.0}))
        False
    """
    digest = hashlib.sha256(repr(networks.command_range).encode())
    for name, value in sorted(networks.state_dict().items()):
        if isinstance(value, torch.Tensor):
            digest.update(name.encode() + value.detach().cpu().numpy().tobytes())
    return digest.hexdigest()[:16]

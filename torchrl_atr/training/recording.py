"""Entries that are computed once for a whole batch, before its epochs: estimates of the latent, a teacher's actions."""

from __future__ import annotations

import copy
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase


@torch.no_grad()
def record_output(
    module: TensorDictModuleBase, batch: TensorDictBase, size: int, key: NestedKey, name: NestedKey | None = None
) -> None:
    """Write an output of a module into a batch (B,), without gradient, computed in parts of ``size``.

    Args:
        module: reads entries of the batch.
        batch: changed in place.
        size: of a part, such as a minibatch.
        key: of the output.
        name: key under which it is written; None for the same.

    Example:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> batch = TensorDict(x=torch.ones(5, 2), batch_size=[5])
        >>> record_output(TensorDictModule(torch.neg, ["x"], ["y"]), batch, 3, "y", "teacher")
        >>> batch["teacher"].sum()
        tensor(-10.)
    """
    parts = [module(part.select(*module.in_keys))[key] for part in batch.split(size)]
    batch.set(key if name is None else name, torch.cat(parts))


class Teacher:
    """Frozen copy of the policy that a run begins from, on privileged information, which a student imitates.

    Args:
        networks: as they are now; later changes do not reach the copy.
    """

    def __init__(self, networks: Any) -> None:
        self.networks = copy.deepcopy(networks).eval().requires_grad_(False)
        self._mean = self.networks.training_actor("privileged").module[0]

    def label(self, batch: TensorDictBase, size: int) -> None:
        """Write ``teacher_mean``, the mean actions that it would take in the states of a batch (B,)."""
        record_output(self._mean, batch, size, "loc", "teacher_mean")

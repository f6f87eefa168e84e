"""Optimiser steps that would spoil the networks are left out, and a run that takes no others is ended."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torchrl_atr._errors import UserError

PATIENCE = 10
"""Optimiser steps in a row that may be left out."""


class TrainingDiverged(UserError, RuntimeError):
    """Losses or gradients that stay without numbers; the last checkpoint is from before."""


class StepGuard:
    """Lets an optimiser step pass if its loss and gradients are finite, and counts the others.

    Steps in a row are those of the same optimisers: what the estimators do says nothing about the policy.

    Args:
        patience: how many steps in a row may be left out.

    Attributes:
        skipped: steps left out so far.

    Example:
        >>> from tensordict import TensorDict
        >>> guard, terms = StepGuard(), TensorDict({"loss_critic": torch.tensor(1.0)})
        >>> guard.admits(terms, {"critic": torch.tensor(float("nan"))}), guard.skipped
        (False, 1)
    """

    def __init__(self, patience: int = PATIENCE) -> None:
        self.patience, self.skipped = patience, 0
        self._in_a_row: Counter[tuple[str, ...]] = Counter()

    def admits(self, terms: TensorDictBase, norms: Mapping[str, Tensor]) -> bool:
        """Whether all loss terms and gradients are finite.

        Args:
            terms: of the loss; those called ``loss_...`` count.
            norms: of the gradients, by the name of their optimiser.

        Raises:
            TrainingDiverged: after ``patience`` steps in a row that were not; names what is not finite.
        """
        named = {str(key): value for key, value in terms.items() if key.startswith("loss_")}
        named |= {f"the gradient of the {name}": norm for name, norm in norms.items()}
        finite = torch.stack([value.detach().float() for value in named.values()]).isfinite().tolist()  # one transfer
        culprits = [name for name, good in zip(named, finite) if not good]
        kind = tuple(norms)
        if not culprits:
            self._in_a_row[kind] = 0
            return True
        self.skipped += 1
        self._in_a_row[kind] += 1
        if self._in_a_row[kind] > self.patience:
            raise TrainingDiverged(
                f"{self._in_a_row[kind]} optimiser steps in a row were not finite ({', '.join(culprits)}): the run "
                "ends with its last checkpoint, go on from it with --resume or start anew with a lower learning rate"
            )
        return False

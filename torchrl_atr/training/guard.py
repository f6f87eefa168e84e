"""Optimiser steps that would spoil the networks are left out, and a run that takes no others is ended."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from torchrl_atr._errors import UserError

PATIENCE = 10
"""Optimiser steps in a row that may be left out."""


class TrainingDiverged(UserError, RuntimeError):
    """Losses or gradients that stay without numbers; the last checkpoint is from before."""


class StepGuard:
    """Says which optimiser steps are to be left out, their loss or gradients not being finite, and counts them.

    What is finite stays where it was computed (:meth:`finite`), so that no step waits for a GPU; it is read once an
    iteration (:meth:`review`). Steps in a row are those of the same optimisers: what the estimators do says nothing
    about the policy.

    It stands for :class:`torch.amp.GradScaler`, which leaves out steps in the same way, but looks at gradients
    alone, waits for the GPU at each step of an optimiser that is not fused, and goes on for ever.

    Args:
        patience: how many steps in a row may be left out.

    Attributes:
        skipped: steps left out so far.

    Example:
        >>> from tensordict import TensorDict
        >>> guard, terms = StepGuard(), TensorDict({"loss_critic": torch.tensor(1.0)})
        >>> finite = guard.finite(terms, {"critic": torch.tensor(float("nan"))})
        >>> guard.review("policy", finite.unsqueeze(0)), guard.skipped
        (None, 1)
    """

    def __init__(self, patience: int = PATIENCE) -> None:
        self.patience, self.skipped = patience, 0
        self._in_a_row: Counter[str] = Counter()

    @staticmethod
    def finite(terms: TensorDictBase, norms: Mapping[str, Tensor]) -> TensorDict:
        """Whether each loss term and gradient is finite, as bools where they are.

        Args:
            terms: of the loss; those called ``loss_...`` count.
            norms: of the gradients, by the name of their optimiser.
        """
        named = {str(key): value.detach().isfinite().all() for key, value in terms.items() if key.startswith("loss_")}
        return TensorDict(named | {f"the gradient of the {name}": norm.isfinite() for name, norm in norms.items()})

    def review(self, kind: str, finite: TensorDictBase) -> None:
        """Counts the steps of an iteration that were left out.

        Args:
            kind: what the steps are of.
            finite: from :meth:`finite`, (steps,).

        Raises:
            TrainingDiverged: after ``patience`` steps in a row that were not; names what is not finite.
        """
        names = list(map(str, finite.keys()))
        for step in torch.stack(list(finite.values()), -1).tolist():
            culprits = [name for name, good in zip(names, step) if not good]
            self._in_a_row[kind] = self._in_a_row[kind] + 1 if culprits else 0
            self.skipped += bool(culprits)
            if self._in_a_row[kind] > self.patience:
                raise TrainingDiverged(
                    f"{self._in_a_row[kind]} optimiser steps in a row were not finite ({', '.join(culprits)}): the "
                    "run ends with its last checkpoint, go on from it with --resume or start anew with a lower "
                    "learning rate"
                )

"""Guard against non-finite losses and gradients: such optimiser steps are skipped, and a run of nothing else ends."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from torchrl_atr._errors import UserError

PATIENCE = 10
"""Number of consecutive optimiser steps that may be skipped."""


class TrainingDiverged(UserError, RuntimeError):
    """Error of losses or gradients that stay non-finite; the last checkpoint is from before."""


class StepGuard:
    """Counter of optimiser steps to skip, those whose loss or gradients are not finite.

    The flags stay on the device that computed them (:meth:`finite`), so that no step waits for a GPU; they are read
    once an iteration (:meth:`review`). Consecutive steps are those of the same optimisers: steps of the estimators say
    nothing about the policy.

    It replaces :class:`torch.amp.GradScaler`, which skips steps in the same way, but checks gradients alone, waits for
    the GPU at each step of an optimiser that is not fused, and never ends a run.

    Attributes:
        skipped: steps skipped so far.

    Example:
        >>> from tensordict import TensorDict
        >>> guard, terms = StepGuard(), TensorDict({"loss_critic": torch.tensor(1.0)})
        >>> finite = guard.finite(terms, {"critic": torch.tensor(float("nan"))})
        >>> guard.review("policy", finite.unsqueeze(0)), guard.skipped
        (None, 1)
    """

    def __init__(self) -> None:
        self.skipped = 0
        self._in_a_row: Counter[str] = Counter()

    @staticmethod
    def finite(terms: TensorDictBase, norms: Mapping[str, Tensor]) -> TensorDict:
        """Return whether each term called ``loss_...``, and each optimiser's gradient norm, is finite: scalars."""
        named = {str(key): value.detach().isfinite().all() for key, value in terms.items() if key.startswith("loss_")}
        return TensorDict(named | {f"the gradient of the {name}": norm.isfinite() for name, norm in norms.items()})

    def review(self, kind: str, finite: TensorDictBase) -> None:
        """Count the skipped steps of an iteration, from :meth:`finite` of each, stacked.

        Raises:
            TrainingDiverged: after more than :data:`PATIENCE` such steps of a ``kind`` in a row; names the values.
        """
        names = list(map(str, finite.keys()))
        for step in torch.stack(list(finite.values()), -1).tolist():
            culprits = [name for name, good in zip(names, step) if not good]
            self._in_a_row[kind] = self._in_a_row[kind] + 1 if culprits else 0
            self.skipped += bool(culprits)
            if self._in_a_row[kind] > PATIENCE:
                raise TrainingDiverged(
                    f"{self._in_a_row[kind]} optimiser steps in a row were not finite ({', '.join(culprits)}): the "
                    "run ends with its last checkpoint, continue from it with --resume or start anew with a lower "
                    "learning rate"
                )

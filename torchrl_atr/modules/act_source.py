"""Input sources of the actor: privileged information, estimates, or a mix over the robots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from torchrl_atr.modules.keys import NetworkKeys

ActSourceName = Literal["privileged", "estimated", "mixed"]
"""Name of what the actor reads: the truth, its estimates, or either by robot."""
ACT_SOURCES: tuple[str, ...] = get_args(ActSourceName)
"""All of :data:`ActSourceName`."""
ActorInput = Literal["history", "latent", "extrinsic"]
"""Name of an input that an actor may read beside the observation."""
ACTOR_INPUTS: tuple[ActorInput, ...] = get_args(ActorInput)
"""Inputs that an actor may read beside the observation, in the order in which it reads it."""
_KEYS = NetworkKeys()


def check_source(source: str) -> None:
    """Raise a ``ValueError`` that lists the allowed act sources unless ``source`` is one of them."""
    if source not in ACT_SOURCES:
        raise ValueError(f"Unknown act source {source!r}. Allowed: {', '.join(ACT_SOURCES)}.")


class ActSource(TensorDictModuleBase):
    """Module that writes the actor's inputs ``("act", "intrinsic")`` and ``("act", "extrinsic")``, or one of them.

    ==============  ======================================================================================
    ``privileged``  z of the encoder, with its gradient, and the true extrinsic state: for training
    ``estimated``   both estimates, detached: for deployment
    ``mixed``       the estimates, detached, where the bool ``("act", "student")`` is true, else privileged
    ==============  ======================================================================================

    ``in_keys`` are exactly the entries that the source reads, so a policy built on ``estimated`` provably reads
    nothing privileged.

    Args:
        source (str): one of the three above.
        reads (sequence of str): ``latent``, ``extrinsic`` or both: what the actor reads. Defaults to both.
        latent, extrinsic (NestedKey): the privileged inputs, (*B, L) and (*B, E).
        intrinsic_estimate, extrinsic_estimate (NestedKey): the estimates, same shapes.
        student (NestedKey): the mask of ``mixed``, (*B, 1) bool.
        act_intrinsic, act_extrinsic (NestedKey): the outputs.

    Raises:
        ValueError: if ``source`` is unknown.
        KeyError: if an entry that the source reads is missing.

    Example:
        >>> ActSource("estimated").in_keys
        [('estimate', 'intrinsic'), ('estimate', 'extrinsic')]
    """

    def __init__(
        self,
        source: ActSourceName,
        *,
        reads: Sequence[str] = ("latent", "extrinsic"),
        latent: NestedKey = _KEYS.latent,
        extrinsic: NestedKey = _KEYS.extrinsic,
        intrinsic_estimate: NestedKey = _KEYS.intrinsic_estimate,
        extrinsic_estimate: NestedKey = _KEYS.extrinsic_estimate,
        student: NestedKey = _KEYS.student,
        act_intrinsic: NestedKey = _KEYS.act_intrinsic,
        act_extrinsic: NestedKey = _KEYS.act_extrinsic,
    ) -> None:
        super().__init__()
        check_source(source)
        self.source = source
        keys = {
            "latent": (latent, intrinsic_estimate, act_intrinsic),
            "extrinsic": (extrinsic, extrinsic_estimate, act_extrinsic),
        }
        truth, estimate, self.out_keys = ([keys[name][part] for name in reads] for part in range(3))
        self.in_keys = {"privileged": truth, "estimated": estimate, "mixed": [*truth, *estimate, student]}[source]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the act entries into ``tensordict`` and return it."""
        inputs = [self._get(tensordict, key) for key in self.in_keys]
        if self.source == "privileged":
            chosen = inputs
        elif self.source == "estimated":
            chosen = [value.detach() for value in inputs]
        else:
            *values, student = inputs
            truth, estimate = values[: len(self.out_keys)], values[len(self.out_keys) :]
            chosen = [torch.where(student, e.detach(), t) for t, e in zip(truth, estimate)]
        for key, value in zip(self.out_keys, chosen):
            tensordict.set(key, value)
        return tensordict

    def _get(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        value = tensordict.get(key, None)
        if value is None:
            raise KeyError(
                f"Act source {self.source!r} reads {key!r}, which is not there. Run the encoder "
                "(privileged, mixed), the estimators (estimated, mixed) and AssignActSource (mixed) first, "
                "or rename the key."
            )
        return value


class AssignActSource(TensorDictModuleBase):
    """Module that marks the robots that act on the estimates: the first ``fraction * N`` rows, halves rounded up.

    A row keeps its role for the whole run, so its value targets are of one kind. For rollouts of a batched
    env only: the rows are those of the last batch dimension of the reference entry (*B, N, D), which during
    a rollout is the env dimension; in a stored batch it would be time. A training batch carries the
    recorded mask instead.

    Args:
        student_fraction (float): share of the rows that act on the estimates, in [0, 1]. Defaults to 0.5.
        reference (NestedKey): any entry with one feature dimension, read for its shape and device only.
        student (NestedKey): the output mask, (*B, N, 1) bool.

    Raises:
        ValueError: if the fraction is outside [0, 1], or there is no batch dimension.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> td = AssignActSource(0.5)(TensorDict(observation=torch.zeros(4, 3), batch_size=[4]))
        >>> td["act", "student"].flatten().tolist()
        [True, True, False, False]
    """

    def __init__(
        self,
        student_fraction: float = 0.5,
        *,
        reference: NestedKey = _KEYS.observation,
        student: NestedKey = _KEYS.student,
    ) -> None:
        super().__init__()
        if not 0.0 <= student_fraction <= 1.0:
            raise ValueError(f"student_fraction must be in [0, 1], got {student_fraction}.")
        self.student_fraction = float(student_fraction)
        self.in_keys = [reference]
        self.out_keys = [student]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the mask into ``tensordict`` and return it."""
        reference = tensordict.get(self.in_keys[0])
        if reference.ndim < 2:
            raise ValueError(
                f"AssignActSource needs a batched env: {self.in_keys[0]!r} is {tuple(reference.shape)}, "
                "without a row dimension. Use source='privileged' or 'estimated' for a single robot."
            )
        rows = reference.shape[-2]
        students = int(self.student_fraction * rows + 0.5)
        mask = torch.arange(rows, device=reference.device).lt(students).unsqueeze(-1)
        tensordict.set(self.out_keys[0], mask.expand(*reference.shape[:-1], 1).clone())
        return tensordict

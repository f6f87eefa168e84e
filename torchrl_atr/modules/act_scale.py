"""Standard deviations of the actor's inputs: those of the estimates, or zero for what is known."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchrl_atr.modules.act_source import ActSourceName, check_source


class ActScale(TensorDictModuleBase):
    """Module that tells the actor how far to trust an input: the estimate's standard deviation, zero for the truth.

    ==============  ================================================================
    ``privileged``  zero
    ``estimated``   the estimate's, detached
    ``mixed``       that where the robot acts on the estimates, else zero
    ==============  ================================================================

    Args:
        source (str): of the actor's inputs, see :class:`~torchrl_atr.modules.ActSource`.
        scale (NestedKey): the estimate's standard deviation, (*B, E).
        chosen (NestedKey): the actor's input that it belongs to, read for its shape, (*B, E).
        student (NestedKey): the mask of ``mixed``, (*B, 1) bool.
        act_scale (NestedKey): the output, (*B, E).

    Raises:
        ValueError: if ``source`` is unknown.
        KeyError: if no estimator has written the scale.

    Example:
        >>> from tensordict import TensorDict
        >>> module = ActScale("privileged", scale="s", chosen="x", student="student", act_scale="act_s")
        >>> module(TensorDict(x=torch.ones(2, 3), batch_size=[2]))["act_s"].sum()
        tensor(0.)
    """

    def __init__(
        self, source: ActSourceName, *, scale: NestedKey, chosen: NestedKey, student: NestedKey, act_scale: NestedKey
    ) -> None:
        super().__init__()
        check_source(source)
        self.source = source
        reads = {"privileged": [chosen], "estimated": [scale], "mixed": [scale, student]}
        self.in_keys, self.out_keys = reads[source], [act_scale]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the standard deviation that the actor reads into ``tensordict`` and return it."""
        first, *mask = (tensordict.get(key) for key in self.in_keys)
        if first is None:
            raise KeyError(
                f"the actor reads the scale {self.in_keys[0]!r}, which no estimator wrote; take one that estimates "
                "standard deviations, such as 'gaussian'"
            )
        scale = torch.zeros_like(first) if self.source == "privileged" else first.detach()
        if mask:
            scale = torch.where(mask[0], scale, torch.zeros_like(scale))
        return tensordict.set(self.out_keys[0], scale)

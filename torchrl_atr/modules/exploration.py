"""Exploration that lasts: Gaussian actions whose noise is correlated in time."""

from __future__ import annotations

import math

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import IndependentNormal, ProbabilisticActor


class CorrelatedGaussian(TensorDictModuleBase):
    """Samples actions loc + scale · ε with ε_t = ρ ε_{t-1} + √(1 - ρ²) ξ_t, for rollouts of a batched env.

    At every step the action has the policy's own marginal distribution, and its log-probability is that of
    the marginal: a loss that recomputes it finds an importance ratio of one. But a deviation now lasts for
    1 / (1 - ρ) steps, long enough to lean, tilt the board and feel it turn; white noise at 50 Hz averages out
    before anything has moved. The noise runs on through resets.

    Args:
        correlation (float): ρ in [0, 1); 0 is white noise.
        loc, scale (NestedKey): the policy's mean and standard deviation, (*B, A).
        action (NestedKey): what is written, with ``<action>_log_prob`` beside it.

    Raises:
        ValueError: unless ``0 <= correlation < 1``.

    Examples:
        >>> from tensordict import TensorDict
        >>> explore = CorrelatedGaussian(0.9)
        >>> td = explore(TensorDict(loc=torch.zeros(4, 2), scale=torch.ones(4, 2), batch_size=[4]))
        >>> td["action"].shape, td["action_log_prob"].shape
        (torch.Size([4, 2]), torch.Size([4]))
    """

    def __init__(
        self,
        correlation: float,
        *,
        loc: NestedKey = "loc",
        scale: NestedKey = "scale",
        action: NestedKey = "action",
    ) -> None:
        super().__init__()
        if not 0.0 <= correlation < 1.0:
            raise ValueError(f"correlation must be in [0, 1), got {correlation}; 0 is white noise.")
        self.correlation = float(correlation)
        self._noise: Tensor | None = None
        log_prob = f"{action}_log_prob" if isinstance(action, str) else (*action[:-1], f"{action[-1]}_log_prob")
        self.in_keys = [loc, scale]
        self.out_keys = [action, log_prob]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action and its log-probability; the mean under ``ExplorationType.DETERMINISTIC``."""
        loc, scale = (tensordict.get(key) for key in self.in_keys)
        action = loc
        if exploration_type() not in (ExplorationType.DETERMINISTIC, ExplorationType.MODE, ExplorationType.MEAN):
            fresh = torch.randn_like(loc)
            if self._noise is None or self._noise.shape != loc.shape:
                self._noise = fresh
            else:
                self._noise = self.correlation * self._noise + math.sqrt(1 - self.correlation**2) * fresh
            action = loc + scale * self._noise
        tensordict.set(self.out_keys[0], action)
        return tensordict.set(self.out_keys[1], IndependentNormal(loc, scale).log_prob(action))


def correlate(actor: ProbabilisticActor, correlation: float, action: NestedKey = "action") -> TensorDictSequential:
    """Replace an actor's sampling by :class:`CorrelatedGaussian`; the networks stay shared.

    Args:
        actor (ProbabilisticActor): a diagonal Gaussian policy that writes ``loc`` and ``scale``.
        correlation (float): ρ in [0, 1).
        action (NestedKey): what the actor writes.

    Returns:
        TensorDictSequential: the policy for a collector.

    Examples:
        >>> from torchrl_atr.modules import ActorBackbone, RunningNormalizer, make_actor
        >>> actor = make_actor(ActorBackbone(RunningNormalizer(5), RunningNormalizer(4), 3, 2))
        >>> correlate(actor, 0.9).in_keys
        ['observation', ('act', 'intrinsic'), ('act', 'extrinsic')]
    """
    *networks, _ = actor.module
    return TensorDictSequential(*networks, CorrelatedGaussian(correlation, action=action))

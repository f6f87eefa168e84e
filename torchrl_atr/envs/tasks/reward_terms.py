"""Reward terms as data, and their sum."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchrl_atr._checks import check_number
from torchrl_atr._errors import InputError
from torchrl_atr.envs.physics.engine import CONTROL_DT
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.term_checks import try_term

TERMINATION = "termination"
"""Name of the term that scores early terminations: A17 leaves it out of the clip, and failed simulations cost it."""


class RewardError(InputError):
    """Error of a reward term that cannot be used; the message names it."""


@dataclass(frozen=True)
class RewardTerm:
    """Term of the reward: ``weight`` times the value of ``function``.

    Attributes:
        function: from a :class:`~torchrl_atr.envs.tasks.context.StepContext` to an unweighted (N,) tensor, non-negative
            for penalties.
        weight: signed, so that penalties have negative ones.
        symbol: in the paper, such as ``"r5"``; empty for custom terms.

    Raises:
        RewardError: if the weight is not a finite number, or the function cannot be called.

    Example:
        >>> from torchrl_atr.envs.tasks.riding import RIDING_REWARDS
        >>> slow = RewardTerm(lambda context: context.state.speeds[:, 0].abs(), weight=-0.1)
        >>> rewards = {**RIDING_REWARDS, "slow": slow}
        >>> rewards["heading_alignment"] = RIDING_REWARDS["heading_alignment"].weighted(-8.0)
    """

    function: Callable[[StepContext], Tensor]
    weight: float
    symbol: str = ""

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise RewardError(f"function={self.function!r} of a reward term cannot be called; give a function")
        try:
            check_number("weight", self.weight)
        except InputError:
            raise RewardError(f"weight={self.weight!r} of a reward term is no finite number") from None

    def __call__(self, context: StepContext) -> Tensor:
        """Return the weighted term, (N,)."""
        return self.weight * self.function(context)

    def weighted(self, weight: float) -> RewardTerm:
        """Return the same term with another weight."""
        return dataclasses.replace(self, weight=weight)


class RewardFunction:
    """Reward terms of an env, checked once, and their sum.

    Args:
        terms: by name.
        context: of N robots, on which every term is checked; its interpretation decides whether rewards are multiplied
            by the control period (A16) and clipped (A17).
        tracking: names of the terms that a command curriculum scores.

    Attributes:
        terms: by name.
        scale: factor of every term: the control period, or 1.

    Raises:
        RewardError: names the term that is not a :class:`RewardTerm`, fails, or does not return floats of shape (N,).
    """

    def __init__(self, terms: Mapping[str, RewardTerm], context: StepContext, tracking: Sequence[str] = ()) -> None:
        if not isinstance(terms, Mapping) or not terms:
            raise RewardError(f"rewards={terms!r}; give a mapping of names to RewardTerm, such as RIDING_REWARDS")
        self.terms, self.interpretation, self._tracking = dict(terms), context.interpretation, tuple(tracking)
        self.scale = CONTROL_DT if self.interpretation.rewards_times_dt else 1.0
        for name, term in self.terms.items():
            _try(name, term, context)
        weights = [self.scale * term.weight for term in self.terms.values()]
        self._weights = torch.tensor(weights, dtype=torch.float32).reshape(-1, 1, 1)

    def __call__(self, context: StepContext) -> tuple[Tensor, Tensor]:
        """Compute all terms and their sum.

        Returns:
            ``reward`` (N, 1) and the scaled terms, (terms, N, 1) in the order of :attr:`terms`, float32 whatever a
            function returned; they add up to ``reward`` unless what is below zero is clipped before termination is
            added (A17).
        """
        terms = torch.stack([term.function(context) for term in self.terms.values()]).to(self._weights.dtype)
        terms = terms.unsqueeze(-1) * self._weights
        total = terms.sum(0)
        if self.interpretation.positive_rewards:
            names = list(self.terms)
            ended = terms[names.index(TERMINATION)] if TERMINATION in names else torch.zeros_like(total)
            total = (total - ended).clamp_min(0.0) + ended
        return total, terms

    @property
    def tracking_max(self) -> dict[str, float]:
        """Scaled values of the tracking terms at zero error; 0 for one that was left out."""
        return {name: self._scaled_weight(name) for name in self._tracking}

    @property
    def termination_cost(self) -> float:
        """Scaled reward of an early termination (r17)."""
        return self._scaled_weight(TERMINATION)

    def _scaled_weight(self, name: str) -> float:
        return self.scale * self.terms[name].weight if name in self.terms else 0.0


def _try(name: str, term: RewardTerm, context: StepContext) -> None:
    if not isinstance(name, str) or not isinstance(term, RewardTerm):
        raise RewardError(f"the reward term {name!r} is {term!r}; give a RewardTerm by its name")
    try_term(f"the reward term {name!r}", term, context, tuple(context.terminated.shape), None, RewardError)

"""Reward terms as data, and their sum."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchrl_atr._checks import check_number
from torchrl_atr._errors import InputError
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.profiles import Readings
from torchrl_atr.envs.task.state import CONTROL_DT, RidingState

TERMINATION = "termination"
"""Name of the term that scores early terminations: A17 leaves it out of the clip, and failed simulations cost it."""
TRACKING = ("forward_command", "steering_command")
"""Names of the terms that the command curriculum's thresholds are shares of: their weights are reached at no error."""


@dataclass
class RewardContext:
    """The inputs of a reward term.

    Attributes:
        state: N robots after the step.
        command: (c_v, c_ω) in force during the step, (N, 2).
        action: a_t, (N, 12).
        previous_action: a_{t-1}, (N, 12).
        terminated: early terminations, (N,) bool.
        robot: q0 and h_des.
        deck_thickness: m.
        readings: the paper's open points.
    """

    state: RidingState
    command: Tensor
    action: Tensor
    previous_action: Tensor
    terminated: Tensor
    robot: RobotSpec
    deck_thickness: float
    readings: Readings = field(default_factory=Readings)


class RewardError(InputError):
    """A reward term that cannot be used; the message names it."""


@dataclass(frozen=True)
class RewardTerm:
    """A term of the reward: ``weight`` times what ``function`` returns.

    Attributes:
        function: from a :class:`RewardContext` to an unweighted (N,) tensor, non-negative for penalties.
        weight: signed, so that penalties have negative ones.
        symbol: in the paper, such as ``"r5"``; empty for terms of one's own.

    Raises:
        RewardError: if the weight is no finite number, or the function cannot be called.

    Example:
        >>> from torchrl_atr.envs.task.rewards import RIDING_REWARDS
        >>> slow = RewardTerm(lambda context: context.state.speeds[:, 0].abs(), weight=-0.1)
        >>> rewards = {**RIDING_REWARDS, "slow": slow}
        >>> rewards["heading_alignment"] = RIDING_REWARDS["heading_alignment"].weighted(-8.0)
    """

    function: Callable[[RewardContext], Tensor]
    weight: float
    symbol: str = ""

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise RewardError(f"function={self.function!r} of a reward term cannot be called; give a function")
        try:
            check_number("weight", self.weight)
        except InputError:
            raise RewardError(f"weight={self.weight!r} of a reward term is no finite number") from None

    def __call__(self, context: RewardContext) -> Tensor:
        """Return the weighted term, (N,)."""
        return self.weight * self.function(context)

    def weighted(self, weight: float) -> RewardTerm:
        """Return the same term with another weight."""
        return dataclasses.replace(self, weight=weight)


class RewardFunction:
    """The terms of an env, tried once, and how they make up the reward.

    Args:
        terms: by name.
        scene: robot and transporter, for the terms to look at.
        readings: whether rewards are multiplied by the control period (A16) and clipped (A17).
        state: of N robots, on which every term is tried.

    Attributes:
        terms: by name.
        scale: what every term is multiplied by: the control period, or 1.

    Raises:
        RewardError: names the term that is no :class:`RewardTerm`, fails, or does not return floats of shape (N,).
    """

    def __init__(self, terms: Mapping[str, RewardTerm], scene: Scene, readings: Readings, state: RidingState) -> None:
        if not isinstance(terms, Mapping) or not terms:
            raise RewardError(f"rewards={terms!r}; give a mapping of names to RewardTerm, such as RIDING_REWARDS")
        self.terms, self.scene, self.readings = dict(terms), scene, readings
        self.scale = CONTROL_DT if readings.rewards_times_dt else 1.0
        idle = torch.zeros_like(state.joint_position)
        context = self.context(state, idle[:, :2], idle, idle, torch.zeros(len(idle), dtype=torch.bool))
        for name, term in self.terms.items():
            _try(name, term, context)

    def context(
        self, state: RidingState, command: Tensor, action: Tensor, previous_action: Tensor, terminated: Tensor
    ) -> RewardContext:
        """Return what the terms look at; see :class:`RewardContext`."""
        robot, thickness = self.scene.robot, self.scene.transporter.size[2]
        return RewardContext(state, command, action, previous_action, terminated, robot, thickness, self.readings)

    def __call__(self, context: RewardContext) -> tuple[Tensor, Tensor]:
        """Compute all terms and their sum.

        Returns:
            ``reward`` (N, 1) and the scaled terms, (terms, N, 1) in the order of :attr:`terms`; they add up to
            ``reward`` unless what is below zero is clipped before termination is added (A17).
        """
        terms = self.scale * torch.stack([term(context) for term in self.terms.values()]).unsqueeze(-1)
        total = terms.sum(0)
        if self.readings.positive_rewards:
            names = list(self.terms)
            ended = terms[names.index(TERMINATION)] if TERMINATION in names else torch.zeros_like(total)
            total = (total - ended).clamp_min(0.0) + ended
        return total, terms

    @property
    def tracking_max(self) -> dict[str, float]:
        """Scaled values of the tracking terms at no error; 0 for one that was left out."""
        return {name: self._scaled_weight(name) for name in TRACKING}

    @property
    def termination_cost(self) -> float:
        """Scaled reward of an early termination (r17)."""
        return self._scaled_weight(TERMINATION)

    def _scaled_weight(self, name: str) -> float:
        return self.scale * self.terms[name].weight if name in self.terms else 0.0


def _try(name: str, term: RewardTerm, context: RewardContext) -> None:
    if not isinstance(name, str) or not isinstance(term, RewardTerm):
        raise RewardError(f"the reward term {name!r} is {term!r}; give a RewardTerm by its name")
    try:
        value = term(context)
    except Exception as error:  # of the user's function
        raise RewardError(f"the reward term {name!r} failed: {type(error).__name__}: {error}") from error
    expected = tuple(context.terminated.shape)
    shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
    if shape != expected or not value.is_floating_point():
        raise RewardError(f"the reward term {name!r} returned {shape}; it must return floats of shape {expected}")

"""Schedules of the weights of reward terms for the learner over a run; the env's own rewards stay as they are."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from tensordict import TensorDictBase

from torchrl_atr._settings import ConfigError

RewardSchedule = Mapping[str, Callable[[float], float]]
"""Factor of each reward term by name, a function of the progress of the run in [0, 1]."""


def factors_at(schedule: RewardSchedule, progress: float) -> dict[str, float]:
    """Return the factors at a progress of the run; beyond [0, 1] the nearer end counts.

    Example:
        >>> factors_at({"torque": lambda progress: 1.0 + progress}, 0.5)
        {'torque': 1.5}
    """
    share = min(max(progress, 0.0), 1.0)
    return {name: float(factor(share)) for name, factor in schedule.items()}


def with_factors(batch: TensorDictBase, factors: Mapping[str, float]) -> TensorDictBase:
    """Add (factor - 1) · term to the reward of a batch for each factor, in place.

    Raises:
        ConfigError: if ``next`` lacks a term.

    Example:
        >>> from tensordict import TensorDict
        >>> import torch
        >>> after = {"reward": torch.ones(2, 1), "reward_terms": {"torque": -torch.ones(2, 1)}}
        >>> with_factors(TensorDict({"next": after}, [2]), {"torque": 3.0})["next", "reward"].squeeze(-1)
        tensor([-1., -1.])
    """
    if not factors:
        return batch
    terms = batch["next"].get("reward_terms", {})
    check_reward_terms(factors, terms.keys())
    extra = sum((factor - 1.0) * terms[name] for name, factor in factors.items() if factor != 1.0)
    return batch.set(("next", "reward"), batch["next", "reward"] + extra)


def check_reward_terms(schedule: Collection[str], terms: Collection[str]) -> None:
    """Raise a :class:`ConfigError` if a schedule names a term that the env does not emit under ``reward_terms``."""
    for name in schedule:
        if name not in terms:
            known = ", ".join(map(str, terms)) or "none"
            raise ConfigError(
                f"the reward schedule names the term {name!r}, but the env's reward_terms are {known}; leave it out of "
                "the schedule, or emit the term"
            )

"""Metrics of a batch: tracking errors, episode lengths, reward terms."""

from __future__ import annotations

from tensordict import TensorDictBase
from torch import Tensor

from torchrl_atr.envs.physics import CONTROL_DT

_ERRORS = ("speed_error", "yaw_error")
"""Metrics of the two components of a command."""


def batch_metrics(batch: TensorDictBase) -> dict[str, float]:
    """Return means over a batch of any env, of those metrics whose entries it holds.

    Args:
        batch: (N, T) with ``next`` holding ``reward`` and the done flags, and where the env emits them ``speeds`` (and
            ``command`` beside it), ``reward_terms``, ``step_count`` and ``episode_reward``.

    Returns:
        ``reward``; those of :func:`riding_metrics` where there are speeds and commands; ``episode_length`` (steps, with
        those that staggered first episodes begin at) and ``episode_reward`` of finished episodes where there are any;
        ``reward/...`` means of the terms.
    """
    after = batch["next"]
    metrics = {"reward": float(after["reward"].mean())}
    if "speeds" in after and "command" in batch:
        metrics.update(riding_metrics(batch))
    done = after["done"].squeeze(-1)
    for name, key in (("episode_length", "step_count"), ("episode_reward", "episode_reward")):
        if key in after and done.any():
            metrics[name] = float(after[key].squeeze(-1)[done].float().mean())
    for term, value in after.get("reward_terms", {}).items():
        metrics[f"reward/{term}"] = float(value.mean())
    return metrics


def riding_metrics(batch: TensorDictBase) -> dict[str, float]:
    """Return the errors and falls under commands in a batch of the riding env.

    Args:
        batch: (N, T) with ``command``, and ``next`` holding ``speeds`` and ``terminated``.

    Returns:
        ``speed_error`` (m/s) and ``yaw_error`` (rad/s), mean absolute differences of speeds and commands;
        ``falls_per_minute``, terminations in a minute of a robot's riding, overspeed included; the same for the robots
        that act on estimates (``student_...``) where some do; ``yaw_gain``, the share of the commanded yaw rate that is
        reached (moving starts give an untrained policy some).
    """
    after, metrics = batch["next"], {}
    student = batch.get(("act", "student"), None)
    for name, error in zip(_ERRORS, (after["speeds"] - batch["command"]).abs().split(1, -1)):
        metrics[name] = float(error.mean())
        if student is not None and student.any():
            metrics[f"student_{name}"] = float(error[student].mean())
    metrics["yaw_gain"] = _regression_gain(batch["command"][..., 1], after["speeds"][..., 1])
    fallen = after["terminated"].float() * (60.0 / CONTROL_DT)
    metrics["falls_per_minute"] = float(fallen.mean())
    if student is not None and student.any():
        metrics["student_falls_per_minute"] = float(fallen[student].mean())
    return metrics


def _regression_gain(command: Tensor, yaw_rate: Tensor) -> float:
    """Return Σ c_ω ω / Σ c_ω²: 1 for perfect steering."""
    return float((command * yaw_rate).sum() / command.square().sum().clamp_min(1e-6))

"""Metrics of a batch: tracking errors, episode lengths, reward terms."""

from __future__ import annotations

from tensordict import TensorDictBase

from torchrl_atr.envs.physics import CONTROL_DT


def batch_metrics(batch: TensorDictBase) -> dict[str, float]:
    """Return means over a batch (N, T) of any env, of those metrics whose entries it holds.

    They are ``reward``; those of :func:`tracking_metrics` where there are ``speeds`` and a ``command``;
    ``episode_length`` (steps, with those that staggered first episodes begin at) and ``episode_reward`` of finished
    episodes where there are any; ``reward/...`` of the terms.
    """
    after = batch["next"]
    metrics = {"reward": float(after["reward"].mean())}
    if "speeds" in after and "command" in batch:
        metrics.update(tracking_metrics(batch))
    done = after["done"].squeeze(-1)
    for name, key in (("episode_length", "step_count"), ("episode_reward", "episode_reward")):
        if key in after and done.any():
            metrics[name] = float(after[key].squeeze(-1)[done].float().mean())
    for term, value in after.get("reward_terms", {}).items():
        metrics[f"reward/{term}"] = float(value.mean())
    return metrics


def tracking_metrics(batch: TensorDictBase) -> dict[str, float]:
    """Return the errors and falls under commands in a batch (N, T).

    They are ``speed_error`` (m/s) and ``yaw_error`` (rad/s), mean absolute differences of speeds and commands;
    ``falls_per_minute``, terminations in a minute of a robot's riding, overspeed included; the same for the robots that
    act on estimates (``student_...``) where some do; ``yaw_gain``, the share of the commanded yaw rate that is reached
    (moving starts give an untrained policy some), Σ c_ω ω / Σ c_ω².
    """
    after, metrics = batch["next"], {}
    student = batch.get(("act", "student"), None)
    for name, error in zip(("speed_error", "yaw_error"), (after["speeds"] - batch["command"]).abs().split(1, -1)):
        metrics[name] = float(error.mean())
        if student is not None and student.any():
            metrics[f"student_{name}"] = float(error[student].mean())
    command, yaw_rate = batch["command"][..., 1], after["speeds"][..., 1]
    metrics["yaw_gain"] = float((command * yaw_rate).sum() / command.square().sum().clamp_min(1e-6))
    fallen = after["terminated"].float() * (60.0 / CONTROL_DT)
    metrics["falls_per_minute"] = float(fallen.mean())
    if student is not None and student.any():
        metrics["student_falls_per_minute"] = float(fallen[student].mean())
    return metrics

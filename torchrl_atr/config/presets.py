"""Presets, the settings of tasks that differ from riding's, and the additions to the paper's method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torchrl_atr._registry import Registry
from torchrl_atr._settings import Setting, settings
from torchrl_atr.config.train_config import TrainConfig

PRESETS: Registry[Mapping[str, Any]] = Registry("preset")
"""Settings that differ from the defaults, by preset; register your own.

``default`` learns best on a laptop. ``paper`` is the paper's own method: nothing of :func:`additions`, the physics that
makes its text true, and Extreme Parkour's hyper-parameters where it gives none. ``literal`` takes every formula as
printed, ``legged_gym`` follows the code that the paper builds on; both without additions. The others are other ways of
adaptation, ``default`` in all else: docs/adaptation.md.
"""
STUDENTS: set[str] = {"rma", "distillation"}
"""Presets of a second phase: their settings take the place of those of the run that they begin from."""
for _name in ("default", "paper", "literal", "legged_gym"):
    _values = {path: each.value_in(_name) for path, each in settings(TrainConfig).items()}
    PRESETS.register(
        _name, {path: value for path, value in _values.items() if value != settings(TrainConfig)[path].default}
    )

_LEARNS: dict[str, Any] = {"roa.act_source": "estimated", "estimator.epochs": 1, "exploration.anneal": False}
_WAYS: dict[str, dict[str, Any]] = {
    "teacher": {"roa.act_source": "privileged", "roa.coeff": 0.0, "estimator.epochs": 0},
    "rma": {**_LEARNS, "roa.policy_update": "none"},
    "distillation": {**_LEARNS, "roa.policy_update": "imitation"},
    "concurrent": {"roa.actor_reads": ("extrinsic",), "roa.act_source": "estimated"},
    "asymmetric": {
        "roa.actor_reads": ("history",),
        "ppo.tracking_errors": False,
        "estimator.dead_reckoning": False,
        "env.reposition_feet": 0.0,
    },
}
for _name in _WAYS:
    PRESETS.register(_name, _WAYS[_name])

TASK_SETTINGS: dict[str, Mapping[str, Any]] = {
    "walking": {
        "env.episode_seconds": 20.0,
        "env.first_episode_seconds": 0.0,
        "env.reposition_feet": 0.0,
        "task.sensors": "ideal",
        "task.moving_start": 0.0,
        "task.displaced_start": 0.0,
        "task.pushes.interval": 3.0,
        "curriculum.max_speed": 0.0,
        "curriculum.max_yaw_rate": 0.0,
        "curriculum.slew_rates": (),
        "curriculum.initial_speed": 0.0,
        "curriculum.initial_yaw_rate": 0.0,
        "exploration.init_std": 0.8,
        "exploration.relative_std": 0.8,
        "exploration.min_std": 0.05,
        "exploration.anneal_from": 0.35,
        "exploration.anneal_until": 1.0,
        "exploration.final_std": 0.12,
        "exploration.noise_correlation": 0.0,
        "ppo.rollout_steps": 24,
        "ppo.gamma": 0.99,
        "ppo.gae_lambda": 0.95,
        "ppo.epochs": 3,
        "ppo.learning_rate": 1e-3,
        "ppo.max_learning_rate": 3e-3,
        "ppo.entropy_coeff": 0.01,
        "ppo.smoothness_coeff": 0.0,
        "ppo.command_interaction": False,
        "ppo.tracking_errors": False,
        "estimator.dead_reckoning": False,
    },
}
"""Settings of tasks that differ from riding's; a custom task may add its own."""


def additions() -> list[Setting]:
    """Return everything that is added to the paper's method: the settings that turn it off, as they are in ``paper``.

    Example:
        >>> [(each.path, each.value_in("paper")) for each in additions() if each.addition == "smoothness loss"]
        [('ppo.smoothness_coeff', 0.0)]
    """
    return [each for each in settings(TrainConfig).values() if each.addition]

"""Within what each number of the recipe makes sense."""

from __future__ import annotations

from typing import Any

import numpy as np

from torchrl_atr._checks import check_flag, check_kind, check_whole
from torchrl_atr._errors import InputError
from torchrl_atr.envs.transforms import CommandGrid

BOUNDS = CommandGrid().bounds
"""The paper's largest command: m/s and rad/s."""
_POSITIVE = 1e-12
RANGES: dict[str, tuple[float, float]] = {
    "num_envs": (1, 1_000_000),
    "rollout_steps": (2, 100_000),
    "total_frames": (1, 1e15),
    "max_minutes": (0, 1e9),
    "seed": (0, 2**31 - 1),
    "num_threads": (0, 4096),
    "torch_threads": (0, 4096),
    "workers": (1, 4096),
    "gamma": (0, 0.99999),
    "gae_lambda": (0, 1),
    "epochs": (1, 1000),
    "minibatches": (1, 100_000),
    "learning_rate": (_POSITIVE, 1),
    "max_learning_rate": (_POSITIVE, 1),
    "target_kl": (_POSITIVE, 10),
    "final_kl": (_POSITIVE, 10),
    "critic_learning_rate": (_POSITIVE, 1),
    "estimator_learning_rate": (_POSITIVE, 1),
    "clip_epsilon": (_POSITIVE, 1),
    "entropy_coeff": (0, 10),
    "max_grad_norm": (_POSITIVE, 1e9),
    "average_over": (1, 1_000_000),
    "init_std": (1e-3, 10),
    "relative_std": (1e-3, 10),
    "min_std": (0, 10),
    "noise_correlation": (0, 0.999),
    "final_std": (1e-3, 10),
    "anneal_from": (0, 0.99),
    "anneal_until": (0.01, 1),
    "smoothness_coeff": (0, 1e3),
    "roa_coeff": (0, 1e3),
    "adaptation_epochs": (1, 1000),
    "student_fraction": (0, 1),
    "history_length": (1, 1000),
    "moving_start": (0, 1),
    "displaced_start": (0, 1),
    "retry": (0, 1),
    "episode_seconds": (0.1, 1e6),
    "command_seconds": (0.1, 1e6),
    "steering_weight_peak": (0, 100),
    "steering_weight_end": (0, 100),
    "tracking_threshold": (0.01, 1),
    "score_from_seconds": (0, 1e6),
    "initial_speed": (0, BOUNDS[0]),
    "initial_yaw_rate": (0, BOUNDS[1]),
    "max_speed": (0, BOUNDS[0]),
    "max_yaw_rate": (0, BOUNDS[1]),
    "runaway_speed": (_POSITIVE, 1e6),
    "runaway_yaw_rate": (_POSITIVE, 1e6),
    "checkpoint_seconds": (0, 1e6),
}
"""Smallest and largest value of each number."""


def wrong_kind(name: str, value: Any, default: Any) -> str | None:
    """Return what is wrong with the kind of a setting's value, by that of its default; None for nothing.

    Example:
        >>> wrong_kind("compiled", 1.0, False), wrong_kind("gamma", 1, 0.995)
        ('compiled=1.0: choose True or False', None)
    """
    try:
        if isinstance(default, bool):
            check_flag(name, value)
        elif isinstance(default, int):
            check_whole(name, value, low=None)
        elif isinstance(default, float):
            if isinstance(value, bool) or not isinstance(
                value, int | float | np.integer | np.floating
            ):  # NaN: see RANGES
                return f"{name}={value!r}: choose a number"
        elif isinstance(default, tuple):
            check_kind(name, value, tuple, "a tuple")
            for part in value:
                wrong = wrong_kind(name, part, default[0] if default else "")
                if wrong:
                    return wrong
        else:
            check_kind(name, value, str, "a text")
    except InputError as error:
        return str(error)
    return None


def plain(value: Any) -> Any:
    """Return a setting's value as Python's own kind, as JSON has it: numbers of NumPy are accepted.

    Example:
        >>> import numpy as np
        >>> plain(np.int64(4)), plain((np.int64(8),)), plain("cpu")
        (4, (8,), 'cpu')
    """
    if isinstance(value, tuple):
        return tuple(plain(part) for part in value)
    return value.item() if isinstance(value, np.generic) else value

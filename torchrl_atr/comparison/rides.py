"""Rides of the policy on an estimator: what the errors of the estimates cost."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from tensordict.nn import TensorDictModuleBase

from torchrl_atr.comparison.options import CompareOptions
from torchrl_atr.comparison.statistics import Array, interval
from torchrl_atr.evaluation import EnduranceResult, endurance_metrics, evaluate_endurance
from torchrl_atr.evaluation.endurance import overspeed_of
from torchrl_atr.evaluation.endurance_metrics import settled_sums
from torchrl_atr.evaluation.metrics import without_nan
from torchrl_atr.evaluation.ride import MakeEnv
from torchrl_atr.training import TrainConfig

_OTHER_ROBOTS = 1_000_000
"""Distance of the seeds of rides from that of the recording: the intrinsic parameters are others."""
_RIDE = ("n", "seconds", "falls", "survival", "falls_per_minute")
_RIDE_ERRORS = ("settled_speed_error", "settled_yaw_error")
_ALONG_ROBOTS = {"commands": 1, "up_steps": 1, "settled_steps": 1, "settled_error": 1, "estimate_error": 1}
_ALONG_ROBOTS |= {"latent_error": 1, "intrinsics": 0} | dict.fromkeys(("fall_time", "fall_cause"), 0)
_ALONG_ROBOTS |= dict.fromkeys(("since_push", "since_command"), 0)
"""Fields of a ride that have an entry for each robot, and their axis."""


def ride(
    policy: TensorDictModuleBase,
    make_env: MakeEnv,
    config: TrainConfig,
    options: CompareOptions,
    seed: int,
    encoder_module: TensorDictModuleBase,
    tick: Callable[[], None] = lambda: None,
) -> EnduranceResult:
    """Evaluate the endurance of a policy; with the same seed every policy has the same robots and commands.

    Args:
        policy: to ride with.
        make_env: called as ``make_env(num_envs=n, seed=s)``.
        config: of the run, whose limit of speed counts as a fall.
        options: robots, seconds and commands.
        seed: of the training.
        encoder_module: writes the true latent.
        tick: called after every step.
    """
    return evaluate_endurance(
        policy,
        make_env,
        options.riding,
        options.seconds,
        options.command_seconds,
        min(2.0, options.command_seconds / 2),
        options.max_speed,
        options.max_yaw_rate,
        seed + _OTHER_ROBOTS,
        overspeed=overspeed_of(config.env.overspeed_margin),
        encoder_module=encoder_module,
        progress=lambda done, total: tick(),
    )


def ride_figures(rides: Sequence[EnduranceResult]) -> dict[str, Any]:
    """Return survival and tracking errors over the rides of all trainings, with 95 % intervals.

    Robots and trainings are resampled. The interval of survival is at least Wilson's, as nobody may have fallen.

    Args:
        rides: of each training, as many robots each.
    """
    metrics = endurance_metrics(joined(rides))
    up = np.stack([each.survived for each in rides]).astype(np.float64)
    sums, steps = (np.stack(each) for each in zip(*(_settled(each) for each in rides)))
    share = interval(mean_error, up, np.ones_like(up), same_robots=False)
    errors = interval(mean_error, sums, steps, same_robots=False)
    low, high = metrics["survival_interval"]
    ends = {"survival_interval": [np.fmin(low, share["low"]), np.fmax(high, share["high"])]}
    ends |= {f"{name}_interval": [errors["low"][i], errors["high"][i]] for i, name in enumerate(_RIDE_ERRORS)}
    plain = without_nan({name: [float(end) for end in each] for name, each in ends.items()})
    return {**{name: metrics[name] for name in (*_RIDE, *_RIDE_ERRORS)}, **plain}


def _settled(ride: EnduranceResult) -> tuple[Array, Array]:
    """Return the sums of each robot's errors over settled steps, and the number of these, (n, 2) each."""
    sums, counts = settled_sums(ride)
    return sums.sum(0).T, counts.sum(0).T.astype(np.float64)


def mean_error(sums: Array, steps: Array) -> Array:
    """Return means from sums over steps and the numbers of these; NaN without a step."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return sums / steps


def joined(rides: Sequence[EnduranceResult]) -> EnduranceResult:
    """Return several rides of the same length as one of all their robots."""
    first = rides[0]
    fields: dict[str, Any] = {}
    for name, axis in _ALONG_ROBOTS.items():
        if getattr(first, name) is not None:
            fields[name] = np.concatenate([getattr(ride, name) for ride in rides], axis)
    return dataclasses.replace(first, **fields)

"""Figures from rates: the share of each layer in the limits below it. All ratios are of medians of one run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.timing import Key, Rates, medians

LADDER = ("bare", "transformed", "free", "deployed", "training_policy")
"""Layers of this library above the physics, lowest first."""
EAGER = ("bare_eager", "free_eager")
"""The same without ``compiled=True``, where the others have it."""
PEERS = ("dm_control", "torchrl_ant", "gymnasium_ant")
TRAINED = {"": "training", "riding_": "training_riding"}
"""Training contenders by the prefix of their figures: with untrained networks, and with those of a trained run."""
SCALED = ("bare", "free")
"""Layers that are also measured at other sizes and numbers of threads."""


def bound(physics: float, compute: float) -> float:
    """Compute the frames per second if each took its physics and its arithmetic, one after the other, and nothing else.

    Example:
        >>> bound(20_000.0, 5_000.0)
        4000.0
    """
    return 1 / (1 / physics + 1 / compute)


def rate_records(rates: Rates) -> list[dict[str, Any]]:
    """Return all samples with their medians, for the JSON."""
    return [
        {**key._asdict(), "median": median, "samples": [round(sample, 3) for sample in rates[key]]}
        for key, median in medians(rates).items()
    ]


def ladder(median: dict[Key, float], num_envs: int, threads: int) -> dict[str, float]:
    """Compute the shares of the physics limit, by layer."""
    limit = median[Key("physics", num_envs, threads)]
    keys = [Key(name, num_envs, threads) for name in (*LADDER, *EAGER)]
    return {key.name: median[key] / limit for key in keys if key in median}


def scaling(median: dict[Key, float]) -> list[dict[str, float]]:
    """Return a row for each (N, threads): physics limit and layers, robot steps per second, and the layers' shares."""
    rows = []
    for key in sorted(median):
        if key.name == "physics":
            above = {name: median[key._replace(name=name)] for name in SCALED}
            shares = {f"{name}_of_physics": value / median[key] for name, value in above.items()}
            rows.append({"num_envs": key.num_envs, "threads": key.threads, "physics": median[key], **above, **shares})
    return rows


def training(median: dict[Key, float], flops_per_frame: float) -> list[dict[str, float]]:
    """Return a row for each trained N: both limits, their bound, and rate and share of each of :data:`TRAINED`."""
    (products,) = (value for key, value in median.items() if key.name == "matrix_products")
    compute, rows = products / flops_per_frame, []
    for key in sorted(median):
        if key.name == "training":
            physics = median[key._replace(name="physics")]
            limit = bound(physics, compute)
            row = {"num_envs": key.num_envs, "physics": physics, "compute": compute, "bound": limit}
            for kind, name in TRAINED.items():
                rate = median[key._replace(name=name)]
                row |= {f"{kind}frames_per_second": rate, f"{kind}efficiency": rate / limit}
            rows.append(row)
    return rows


def peers(median: dict[Key, float], ours: Key) -> dict[str, dict[str, float]]:
    """Return the steps per second of each peer that ran, and the ratio of ``ours`` to it."""
    found = {key.name: value for key, value in median.items() if key.name in PEERS}
    return {name: {"steps_per_second": value, "ours_over_it": median[ours] / value} for name, value in found.items()}


def shares(seconds: Sequence[float]) -> list[float]:
    """Return the shares of the phases in their sum.

    Example:
        >>> shares([1.0, 3.0])
        [0.25, 0.75]
    """
    return [value / sum(seconds) for value in seconds]

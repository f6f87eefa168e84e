"""Figures from rates: what each layer leaves of the limits below it. All ratios are of medians of one run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.timing import Key, Rates, medians

LADDER = ("bare", "transformed", "free", "deployed", "training_policy")
"""Ours above the physics, lowest first."""
EAGER = ("bare_eager", "free_eager")
"""The same without ``compiled=True``, where the others have it."""
PEERS = ("dm_control", "torchrl_ant", "gymnasium_ant")
TRAINED = {"": "training", "riding_": "training_riding"}
"""What is trained, by what its figures begin with: untrained networks, and those of a run whose robots ride."""
SCALED = ("bare", "free")
"""What is also measured at other sizes and numbers of threads."""


def bound(physics: float, compute: float) -> float:
    """Frames per second if every frame took its physics and its arithmetic, one after the other, and nothing else.

    Example:
        >>> bound(20_000.0, 5_000.0)
        4000.0
    """
    return 1 / (1 / physics + 1 / compute)


def rate_records(rates: Rates) -> list[dict[str, Any]]:
    """All samples with their medians, for the JSON."""
    return [
        {**key._asdict(), "median": median, "samples": [round(sample, 3) for sample in rates[key]]}
        for key, median in medians(rates).items()
    ]


def ladder(median: dict[Key, float], num_envs: int, threads: int) -> dict[str, float]:
    """Shares of the physics limit, by layer."""
    limit = median[Key("physics", num_envs, threads)]
    keys = [Key(name, num_envs, threads) for name in (*LADDER, *EAGER)]
    return {key.name: median[key] / limit for key in keys if key in median}


def scaling(median: dict[Key, float]) -> list[dict[str, float]]:
    """A row for each (N, threads): the physics limit, what is above it and its share of it, robot steps per second."""
    rows = []
    for key in sorted(median):
        if key.name == "physics":
            above = {name: median[key._replace(name=name)] for name in SCALED}
            shares = {f"{name}_of_physics": value / median[key] for name, value in above.items()}
            rows.append({"num_envs": key.num_envs, "threads": key.threads, "physics": median[key], **above, **shares})
    return rows


def training(median: dict[Key, float], flops_per_frame: float) -> list[dict[str, float]]:
    """For each N that was trained: both limits, their bound, and of each of :data:`TRAINED` rate and share of it."""
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
    """Steps per second of each peer that ran, and how many times as many ``ours`` makes."""
    found = {key.name: value for key, value in median.items() if key.name in PEERS}
    return {name: {"steps_per_second": value, "ours_over_it": median[ours] / value} for name, value in found.items()}


def shares(seconds: Sequence[float]) -> list[float]:
    """Of their sum.

    Example:
        >>> shares([1.0, 3.0])
        [0.25, 0.75]
    """
    return [value / sum(seconds) for value in seconds]

"""Rates of contenders measured in turns, so that other load on the machine affects all of them alike."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch


class Key(NamedTuple):
    """Key of a rate: a contender's name, its robots (envs, rows), its threads (or processes)."""

    name: str
    num_envs: int
    threads: int


@dataclass
class Contender:
    """Timed function.

    Attributes:
        key: of its rates.
        step: does some work and returns its amount: robot control steps, or another unit of its rate.
        close: frees its resources.
    """

    key: Key
    step: Callable[[], int]
    close: Callable[[], object] = lambda: None


Rates = dict[Key, list[float]]
"""Samples per contender, one per round, units of work per second."""


def rate(step: Callable[[], int], seconds: float) -> float:
    """Measure the work per second over as many calls as fill ``seconds``, at least one."""
    work, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds or work == 0:
        work += step()
    return work / elapsed


def interleave(
    contenders: Sequence[Contender], rounds: int, seconds: float, report: Callable[[str], None] = lambda line: None
) -> Rates:
    """Sample every contender once per round, after a warm-up round that does not count.

    Some compile in the warm-up. Each sample follows a step that is not timed, which fills the caches again. torch uses
    as many threads as are set now, but never more than the contender's.

    Args:
        contenders: with different keys.
        rounds: samples of each.
        seconds: least time of a sample.
        report: called with messages about progress.

    Example:
        >>> rates = interleave([Contender(Key("nothing", 1, 1), lambda: 1)], rounds=3, seconds=0.0)
        >>> len(rates["nothing", 1, 1])
        3
    """
    chosen = torch.get_num_threads()
    rates: Rates = {contender.key: [] for contender in contenders}
    try:
        for number in range(rounds + 1):
            report(f"round {number} of {rounds}" if number else "warming up")
            for contender in contenders:
                torch.set_num_threads(min(chosen, contender.key.threads))
                contender.step()
                sample = rate(contender.step, seconds)
                if number:
                    rates[contender.key].append(sample)
    finally:
        torch.set_num_threads(chosen)
    return rates


def medians(rates: Rates) -> dict[Key, float]:
    """Compute the median of each contender's samples."""
    return {key: statistics.median(samples) for key, samples in rates.items()}

"""Rates of contenders that take turns, so that a busy minute of the machine hits all of them alike."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch


class Key(NamedTuple):
    """What a rate belongs to: a contender's name, robots (envs, rows) at once, threads (or processes)."""

    name: str
    num_envs: int
    threads: int


@dataclass
class Contender:
    """Something that is timed.

    Attributes:
        key: of its rates.
        step: does some work and returns how much: robot control steps, or whatever its rate counts.
        close: frees what it holds.
    """

    key: Key
    step: Callable[[], int]
    close: Callable[[], object] = lambda: None


Rates = dict[Key, list[float]]
"""Samples per contender, one a round, units of work per second."""


def rate(step: Callable[[], int], seconds: float) -> float:
    """Work per second over as many calls as fill ``seconds``, one at least."""
    work, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds or work == 0:
        work += step()
    return work / elapsed


def interleave(
    contenders: Sequence[Contender], rounds: int, seconds: float, report: Callable[[str], None] = lambda line: None
) -> Rates:
    """Samples every contender once a round, after a round that does not count.

    Until then some have something to compile. Each sample follows one step that is not timed, since the contender
    before left other things in the caches. torch computes with as many threads as are set now, but never with more than
    the contender's.

    Args:
        contenders: with different keys.
        rounds: samples of each.
        seconds: least time of a sample.
        report: is told what goes on.

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
    """The median of each contender's samples."""
    return {key: statistics.median(samples) for key, samples in rates.items()}

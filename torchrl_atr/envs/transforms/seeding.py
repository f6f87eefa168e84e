"""A transform's own source of randomness: an env's seed does not reach its transforms."""

from __future__ import annotations

import torch


def make_generator(seed: int | None) -> torch.Generator:
    """A generator on the CPU; without a seed from the operating system, so that forked workers draw differently.

    Example:
        >>> make_generator(3).initial_seed()
        3
    """
    generator = torch.Generator()
    if seed is None:
        generator.seed()
    else:
        generator.manual_seed(int(seed))
    return generator

"""A small run whose episodes and commands end all the time, and the comparison of two states."""

from __future__ import annotations

import torch

FRAMES = 6 * 64
SMALL = {
    "env.num_envs": 8,
    "ppo.rollout_steps": 8,
    "total_frames": FRAMES,
    "compute.num_threads": 1,
    "compute.torch_threads": 1,
    "ppo.minibatches": 2,
    "ppo.epochs": 2,
    "env.episode_seconds": 0.3,  # some episodes end in every batch
    "curriculum.command_seconds": 0.2,
    "curriculum.score_from_seconds": 0.02,
}


def differing(one, two, path=""):
    """Paths at which two nested states differ, bit for bit."""
    if isinstance(one, dict):
        if one.keys() != two.keys():
            return [f"{path}: {one.keys() ^ two.keys()}"]
        return [line for key in one for line in differing(one[key], two[key], f"{path}/{key}")]
    if isinstance(one, list | tuple):
        return [line for i, (a, b) in enumerate(zip(one, two, strict=True)) for line in differing(a, b, f"{path}/{i}")]
    if isinstance(one, torch.Tensor):
        return [] if torch.equal(one, two) else [path]
    return [] if one == two else [path]

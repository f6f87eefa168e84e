"""Comparison of a bundle's policy on ONNX Runtime with torch, over the episode that the bundle holds; without torch."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchrl_atr.deploy.manifest import EPISODE, POLICY, BundleError, find_policy, read_manifest
from torchrl_atr.deploy.runner import OnnxPolicy

TOLERANCE = 1e-4
"""Largest difference of an action from torch's, in units of the action scale."""


class Parity(NamedTuple):
    """Comparison of actions over a recorded episode.

    Attributes:
        error: largest difference of an action.
        steps, robots: of the episode.
        resets: episodes that began after the first step.
    """

    error: float
    steps: int
    robots: int
    resets: int


def verify(bundle: str | Path) -> Parity:
    """Check the files of a bundle, and that ONNX Runtime gives the actions that torch gave when it was exported.

    The episode is of several robots in our simulation, with sensor errors, pushes and resets; torch's actions moved
    them. The policy gets the readings of each step and holds its own state.

    Args:
        bundle: its folder, or the name of an installed policy.

    Returns:
        The comparison.

    Raises:
        BundleError: if a file is missing or changed, or an action differs by more than :data:`TOLERANCE`.
    """
    folder, manifest = find_policy(bundle), read_manifest(bundle)
    with np.load(folder / EPISODE) as episode:
        found = compare(folder, manifest, dict(episode))
    if not found.error <= TOLERANCE:
        raise BundleError(
            f"{POLICY} of {folder} acts otherwise than torch, by {found.error:.2g} of the action scale (at most "
            f"{TOLERANCE:g}); use another version of onnxruntime, or export anew with another one of torch"
        )
    return found


def compare(folder: Path, manifest: dict[str, Any], episode: dict[str, np.ndarray]) -> Parity:
    """Return the largest difference of actions from an episode's, whose arrays are (T, N, ...)."""
    start, action = episode.pop("start"), episode.pop("action")
    policy = OnnxPolicy(folder, manifest, robots=start.shape[1])
    replayed = [
        policy(start[t], {name: value[t] for name, value in episode.items()})["action"] for t in range(len(start))
    ]
    error = float(np.abs(np.stack(replayed) - action).max())
    return Parity(error, len(start), start.shape[1], int(start[1:].sum()))

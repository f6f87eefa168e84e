"""Scores of estimators on the validation robots of a recording: sums by robot, from which all figures follow."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torch.nn.functional import one_hot

from torchrl_atr._files import atomic
from torchrl_atr._threads import one_torch_thread
from torchrl_atr.comparison.fitting import estimates, with_first_state
from torchrl_atr.comparison.recording import AGE, Recording, Window, take
from torchrl_atr.comparison.statistics import LinearProbe, effective_dimension
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.modules import ROANetworks
from torchrl_atr.modules.estimators import state_keys

Array = NDArray[np.float64]
BINS = 20
"""Largest number of parts of a ride, by the time since it began, in which errors are summed."""
_EVERY = 10
"""Control steps from one that the probe sees to the next: neighbours are alike."""


@dataclass(frozen=True)
class Scores:
    """Sums over the steps of each of n validation robots; E extrinsic states, L latents, I intrinsic parameters.

    Attributes:
        steps: number of steps by time in the ride, (n, B).
        extrinsic: squared errors, SI units, (n, B, E); ``extrinsic_truth`` and ``extrinsic_truth_squared``: sums of
            the true states and of their squares, (n, E).
        latent: squared errors, (n, B, L); with ``latent_truth`` and ``latent_truth_squared``, (n, L).
        probe: squared errors of the intrinsic parameters, predicted linearly from the estimated latent, (n, I); with
            ``probe_steps``, (n,), ``probe_truth`` and ``probe_truth_squared``, (n, I).
        extrinsic_deviation, latent_deviation: squared errors over the estimated variances, (n, E) and (n, L); empty,
            (n, 0), for an estimator without standard deviations.
        scale: standard deviations of the run's extrinsic states, (E,).
        bin_seconds: length of a part of the ride.
        dimension: effective dimension of the estimated latent.
        parameters: number of the estimators' parameters, those of their own losses included.
        microseconds: CPU time of a control step's estimates for one robot, on one core.
    """

    steps: Array
    extrinsic: Array
    extrinsic_truth: Array
    extrinsic_truth_squared: Array
    latent: Array
    latent_truth: Array
    latent_truth_squared: Array
    probe: Array
    probe_steps: Array
    probe_truth: Array
    probe_truth_squared: Array
    extrinsic_deviation: Array
    latent_deviation: Array
    scale: Array
    bin_seconds: float
    dimension: float
    parameters: int
    microseconds: float

    def save(self, path: Path) -> None:
        """Write them as one ``.npz`` file."""
        with atomic(path) as file:
            np.savez_compressed(file, **{each.name: getattr(self, each.name) for each in fields(self)})

    @staticmethod
    def load(path: Path) -> Scores:
        """Read a file of :meth:`save`."""
        with np.load(path) as file:
            arrays: dict[str, Any] = {name: file[name] for name in file.files}
        return Scores(**{name: value if value.ndim else value.item() for name, value in arrays.items()})


def score(networks: ROANetworks, recording: Recording, window: Window | None = None) -> Scores:
    """Measure the estimators of networks on the validation robots; the probe learns from the robots for training.

    Args:
        networks: with the estimators.
        recording: to measure them on.
        window: what they read of it as history; None for the recorded one.
    """
    keys, data = networks.keys, recording.validation
    width = -(-data.shape[1] // BINS)
    bins = -(-data.shape[1] // width)
    sums, seen = [], []
    for part, written in estimates(networks, data, window):
        sums.append(_sums(networks, part, written, width, bins))
        seen.append(_pair(part[keys.intrinsic], written[keys.intrinsic_estimate]))
    # a hidden state needs every step
    every = 1 if any(map(state_keys, networks.estimator_modules)) else _EVERY
    known = [
        _pair(part[keys.intrinsic], written[keys.intrinsic_estimate], _EVERY // every)
        for part, written in estimates(networks, recording.train, window, every)
    ]
    latents = np.concatenate([latent for latent, _ in seen])
    return Scores(
        **{name: torch.cat([part[name] for part in sums]).numpy() for name in sums[0]},
        **probe_sums(known, seen),
        scale=networks.ext_norm.std.double().numpy(),
        bin_seconds=width * CONTROL_DT,
        dimension=effective_dimension(latents.reshape(-1, latents.shape[-1])),
        parameters=sum(parameter.numel() for parameter in networks.estimator_parameters()),
        microseconds=microseconds(networks, take(data, torch.tensor([0]), torch.tensor([0]), window)),
    )


def score_latent(networks: ROANetworks, recording: Recording) -> tuple[dict[str, Array], float]:
    """Return the sums of the probe, and the effective dimension, of the true latent: what an estimator can reach."""
    keys = networks.keys
    known, seen = ([_pair(data[keys.intrinsic], data[keys.latent])] for data in (recording.train, recording.validation))
    return probe_sums(known, seen), effective_dimension(seen[0][0].reshape(-1, seen[0][0].shape[-1]))


def _sums(networks: ROANetworks, data: TensorDictBase, written: TensorDictBase, width: int, bins: int) -> Any:
    keys = networks.keys
    place = one_hot((data[AGE].squeeze(-1) // width).clamp(max=bins - 1), bins).double()
    sums = {"steps": place.sum(1)}
    rows: list[tuple[str, NestedKey, NestedKey, NestedKey]] = [
        ("extrinsic", keys.extrinsic, keys.extrinsic_estimate, keys.extrinsic_scale),
        ("latent", keys.latent, keys.intrinsic_estimate, keys.intrinsic_scale),
    ]
    for name, truth_key, estimate_key, scale_key in rows:
        truth, scale = data[truth_key].double(), written.get(scale_key, None)
        squared = (written[estimate_key].double() - truth).square()
        deviation = squared[..., :0] if scale is None else squared / scale.double().square()
        sums |= {
            name: torch.einsum("ntb,nte->nbe", place, squared),
            f"{name}_truth": truth.sum(1),
            f"{name}_truth_squared": truth.square().sum(1),
            f"{name}_deviation": deviation.sum(1),
        }
    return sums


def _pair(intrinsic: Tensor, latent: Tensor, every: int = _EVERY) -> tuple[Array, Array]:
    """Return latents and intrinsic parameters of some steps, (n, t, L) and (n, t, I)."""
    return latent[:, ::every].double().numpy(), intrinsic[:, ::every].double().numpy()


def probe_sums(known: Sequence[tuple[Array, Array]], seen: Sequence[tuple[Array, Array]]) -> dict[str, Array]:
    """Fit the probe to known latents and intrinsic parameters, and return the sums of :class:`Scores` on others.

    Args:
        known: latents (n, t, L) and parameters (n, t, I), in parts along n.
        seen: likewise.
    """
    (latents, targets), (others, truth) = (
        [np.concatenate([part[i] for part in parts]) for i in range(2)] for parts in (known, seen)
    )
    probe = LinearProbe(latents.reshape(-1, latents.shape[-1]), targets.reshape(-1, targets.shape[-1]))
    return {
        "probe": ((probe(others) - truth) ** 2).sum(1),
        "probe_steps": np.full(len(truth), truth.shape[1], dtype=np.float64),
        "probe_truth": truth.sum(1),
        "probe_truth_squared": (truth**2).sum(1),
    }


@torch.no_grad()
def microseconds(networks: ROANetworks, step: TensorDictBase, repeats: int = 100) -> float:
    """Return the median time of the estimates of one control step on one core, in eager mode, in CPU time.

    Args:
        networks: whose estimators run.
        step: of one robot, (1,).
        repeats: number of measurements.
    """
    step_input = with_first_state(networks, step.clone())
    runs = [(module, step_input.select(*module.in_keys)) for module in networks.estimator_modules]
    taken = []
    with one_torch_thread():
        for _ in range(repeats // 10 + repeats):  # the first ones are slower
            begin = time.thread_time()
            for module, inputs in runs:
                module(inputs)
            taken.append(time.thread_time() - begin)
    return 1e6 * statistics.median(taken[repeats // 10 :])

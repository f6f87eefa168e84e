"""Metrics and files of trips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchrl_atr._files import atomic, write_json
from torchrl_atr.evaluation.energy import CostOfTransport
from torchrl_atr.evaluation.intervals import mean_interval, wilson
from torchrl_atr.navigation.film import film_best
from torchrl_atr.navigation.map import Map
from torchrl_atr.navigation.overview import COLOURS, plot_trips
from torchrl_atr.navigation.paths import Path
from torchrl_atr.navigation.trips import GOAL, TripsResult

Array = NDArray[np.float64]
_NESTED = ("cost", "traces")


def trip_metrics(result: TripsResult) -> dict[str, Any]:
    """Return shares, and means with 95 % intervals over trips; costs of transport are of trips that reached the goal.

    Returns:
        ``trips``, ``outcomes`` by name, ``success`` with ``success_interval``; ``mean`` and ``interval`` of ``spl``
        over all trips, and of ``seconds``, ``speed``, ``deviation``, ``joint_power``, ``drive_power``, ``cot_paper``,
        ``cot_joints``, ``cot_system`` over successful ones, None without any.
    """
    there = result.outcome == GOAL
    outcomes = {name: int((result.outcome == name).sum()) for name in COLOURS}
    values: dict[str, Array] = {
        "seconds": result.seconds,
        "speed": result.travelled / np.maximum(result.seconds, 1e-9),
        "deviation": result.deviation,
        "joint_power": result.joint_power,
        "drive_power": result.drive_power,
        **{f"cot_{name}": np.asarray(value, dtype=float) for name, value in result.cost._asdict().items()},
    }
    successes, n = int(there.sum()), len(there)
    return {
        "trips": n,
        "outcomes": outcomes,
        "success": successes / n,
        "success_interval": list(wilson(successes, n)),
        "spl": _summary(result.spl),
        **{name: _summary(value[there]) for name, value in values.items()},
    }


def _summary(values: Array) -> dict[str, Any]:
    mean, interval = mean_interval(values)
    return {"mean": mean if len(values) else None, "interval": interval and list(interval)}


def write_trips(
    result: TripsResult, paths: Sequence[Path], where: Map, metrics: Mapping[str, Any], folder: str | FilePath
) -> dict[str, FilePath]:
    """Write ``metrics.json``, ``trips.npz`` (paths, traces, outcomes), ``overview.png`` and one trip as ``trip.gif``.

    Returns:
        The files, by name.
    """
    files = {name: FilePath(folder) / name for name in ("metrics.json", "trips.npz", "overview.png", "trip.gif")}
    write_json(files["metrics.json"], metrics, allow_nan=False)
    save_trips(result, paths, files["trips.npz"])
    plot_trips(result, paths, where, files["overview.png"])
    film_best(result, paths, where, files["trip.gif"])
    return files


def save_trips(result: TripsResult, paths: Sequence[Path], file: str | FilePath) -> None:
    """Write trips and their paths as one ``.npz`` file; :func:`load_trips` reads the trips back."""
    arrays: dict[str, Any] = {name: value for name, value in vars(result).items() if name not in _NESTED}
    arrays |= {f"cot_{name}": value for name, value in result.cost._asdict().items()}
    arrays |= {f"path_{i}": path.points for i, path in enumerate(paths)}
    arrays |= {f"trace_{i}": trace for i, trace in enumerate(result.traces)}
    with atomic(file) as written:
        np.savez_compressed(written, **arrays)


def load_trips(file: str | FilePath) -> TripsResult:
    """Read the trips of a file that :func:`save_trips` wrote."""
    with np.load(file) as arrays:
        values = {field.name: arrays[field.name] for field in fields(TripsResult) if field.name not in _NESTED}
        cost = CostOfTransport(*(arrays[f"cot_{name}"] for name in CostOfTransport._fields))
        traces = [arrays[f"trace_{i}"] for i in range(len(values["outcome"]))]
    return TripsResult(**values, cost=cost, traces=traces)

"""Files of a tracking evaluation: ``metrics.json``, ``tracking.npz`` and the figures, each written atomically."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from torchrl_atr._files import atomic, write_json
from torchrl_atr.evaluation.access import Component
from torchrl_atr.evaluation.envelope import Envelope
from torchrl_atr.evaluation.estimators import EstimationErrors
from torchrl_atr.evaluation.tracking import TrackingResult

_PARTS = {"estimators": EstimationErrors, "envelope": Envelope}
"""Nested fields of a result, stored under names such as ``estimators.components``."""


def write_report(result: TrackingResult, metrics: Mapping[str, Any], output_dir: str | Path) -> dict[str, Path]:
    """Write ``metrics.json``, ``tracking.npz``, ``heatmaps.png``, ``response.png`` and ``command_area.png``.

    Args:
        result: of :func:`~torchrl_atr.evaluation.evaluate_tracking`.
        metrics: of :func:`~torchrl_atr.evaluation.tracking_metrics`; more entries are welcome.
        output_dir: folder; created if it does not exist.

    Returns:
        The files by name.

    Raises:
        ValueError: if ``metrics`` holds NaN or infinity, which JSON cannot.
    """
    from torchrl_atr.evaluation import figures  # imports matplotlib

    folder = Path(output_dir)
    paths = {name: folder / name for name in ("metrics.json", "tracking.npz")}
    write_json(paths["metrics.json"], metrics, allow_nan=False)
    save_tracking(result, paths["tracking.npz"])
    plots = {
        "heatmaps.png": figures.plot_heatmaps,
        "response.png": figures.plot_response,
        "command_area.png": figures.plot_command_area,
    }
    for name, plot in plots.items():
        paths[name] = plot(result, folder / name)
    return paths


def save_tracking(result: TrackingResult, path: str | Path) -> Path:
    """Write all figures of all trials as one ``.npz`` file; :func:`load_tracking` reads it back."""
    arrays = {f.name: getattr(result, f.name) for f in fields(result) if f.name not in _PARTS}
    for part in _PARTS:
        if (value := getattr(result, part)) is not None:
            arrays |= {f"{part}.{f.name}": getattr(value, f.name) for f in fields(value)}
    if result.estimators is not None:
        arrays["estimators.components"] = [
            [name, label, unit or ""] for name, label, unit in result.estimators.components
        ]
    arrays = {name: value for name, value in arrays.items() if value is not None}
    with atomic(path) as file:
        np.savez_compressed(file, **{name: np.asarray(value) for name, value in arrays.items()})  # type: ignore[arg-type]
    return Path(path)


def load_tracking(path: str | Path) -> TrackingResult:
    """Read a file that :func:`save_tracking` wrote.

    Raises:
        FileNotFoundError: if there is no such file.
        KeyError: if an array is missing.
    """
    with np.load(path) as file:
        arrays = {name: _plain(file[name]) for name in file.files}
    own: dict[str, dict[str, Any]] = {part: {} for part in _PARTS}
    for name in [name for name in arrays if name.partition(".")[0] in own]:
        part, _, field = name.partition(".")
        own[part][field] = arrays.pop(name)
    missing = [f.name for f in fields(TrackingResult) if f.name not in _PARTS and f.name not in arrays]
    missing += ["components"] if own["estimators"] and "components" not in own["estimators"] else []
    if missing:
        raise KeyError(f"{path} lacks {', '.join(missing)}: not a tracking file, or an old one; evaluate again")
    return TrackingResult(**arrays, **{part: _PARTS[part](**values) for part, values in own.items() if values})


def _plain(array: np.ndarray) -> Any:
    if array.dtype.kind == "U" and array.ndim == 2:
        return tuple(Component(name, label, unit or None) for name, label, unit in array.tolist())
    if array.dtype.kind == "U" or array.size == 0:
        return tuple(str(item) for item in array)
    return float(array) if array.ndim == 0 else array

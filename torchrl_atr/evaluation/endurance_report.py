"""Files of an endurance evaluation: ``metrics.json``, ``endurance.npz`` and ``endurance.png``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from torchrl_atr._files import atomic, write_json
from torchrl_atr.evaluation.access import Component
from torchrl_atr.evaluation.endurance import EnduranceResult

_TEXTS = ("intrinsic_names", "policy_reads")
_OPTIONAL = ("estimate_error", "latent_error")


def write_endurance(result: EnduranceResult, metrics: Mapping[str, Any], output_dir: str | Path) -> dict[str, Path]:
    """Write ``metrics.json``, ``endurance.npz`` and ``endurance.png``.

    Args:
        result: of :func:`~torchrl_atr.evaluation.evaluate_endurance`.
        metrics: of :func:`~torchrl_atr.evaluation.endurance_metrics`; more entries are welcome.
        output_dir: folder; created if it does not exist.

    Returns:
        The files by name.

    Raises:
        ValueError: if ``metrics`` holds NaN or infinity, which JSON cannot.
    """
    from torchrl_atr.evaluation.endurance_figure import plot_endurance  # imports matplotlib

    folder = Path(output_dir)
    paths = {name: folder / name for name in ("metrics.json", "endurance.npz", "endurance.png")}
    write_json(paths["metrics.json"], metrics, allow_nan=False)
    save_endurance(result, paths["endurance.npz"])
    plot_endurance(metrics, paths["endurance.png"])
    return paths


def save_endurance(result: EnduranceResult, path: str | Path) -> Path:
    """Write an endurance result as one ``.npz`` file; :func:`load_endurance` reads it back."""
    arrays = {field.name: getattr(result, field.name) for field in fields(result)}
    arrays["components"] = np.array(
        [(name, label, unit or "") for name, label, unit in result.components], dtype=np.str_
    ).reshape(-1, 3)
    for name in _TEXTS:
        arrays[name] = np.array(arrays[name], dtype=np.str_)
    known = {name: value for name, value in arrays.items() if value is not None}
    with atomic(path) as file:
        np.savez_compressed(file, **known)
    return Path(path)


def load_endurance(path: str | Path) -> EnduranceResult:
    """Read a file that :func:`save_endurance` wrote.

    Raises:
        FileNotFoundError: if there is no such file.
        KeyError: if an array is missing.
    """
    with np.load(path) as file:
        arrays: dict[str, Any] = {name: file[name] for name in file.files}
    missing = [f.name for f in fields(EnduranceResult) if f.name not in arrays and f.name not in _OPTIONAL]
    if missing:
        raise KeyError(f"{path} lacks {', '.join(missing)}: not an endurance file, or an old one; evaluate again")
    components = [Component(name, label, unit or None) for name, label, unit in arrays["components"].tolist()]
    texts = {name: tuple(arrays[name].tolist()) for name in _TEXTS}
    numbers = {name: float(value) for name, value in arrays.items() if value.ndim == 0}
    speed, yaw_rate = arrays["overspeed"].tolist()
    plain = {"components": tuple(components), "overspeed": (speed, yaw_rate), **texts, **numbers}
    return EnduranceResult(**{**dict.fromkeys(_OPTIONAL), **arrays, **plain})

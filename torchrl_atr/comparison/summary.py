"""Figures of a comparison from its parts: errors, drift, calibration, probe, rides; ready for JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchrl_atr.comparison.recording import Recording
from torchrl_atr.comparison.rides import ride_figures
from torchrl_atr.comparison.scores import Scores, score_latent
from torchrl_atr.comparison.statistics import interval, pooled_r_squared, r_squared, rmse
from torchrl_atr.comparison.study import Outcome
from torchrl_atr.evaluation.metrics import without_nan
from torchrl_atr.modules import ROANetworks

Array = NDArray[np.float64]


def summarize(networks: ROANetworks, recording: Recording, outcomes: Mapping[str, Outcome]) -> dict[str, Any]:
    """Return the figures of a comparison under one set of sensors.

    Args:
        networks: of the run.
        recording: that the estimators were trained and measured on.
        outcomes: by name, of :meth:`torchrl_atr.comparison.Study.run`.

    Returns:
        ``recording``, its sizes; ``latent``, probe and effective dimension of the true latent; ``estimators``, by name:
        ``estimator`` and ``history_length``, None for a reference, figures of :func:`estimator_figures` and ``rides``.
        Nested dicts without NaN.
    """
    data = recording.data
    probe, dimension = score_latent(networks, recording)
    sizes = {
        "robots": data.shape[0],
        "training": recording.training,
        "steps": data.shape[1],
        "rides": int(data["is_init"].sum()),
    }
    rows = {
        name: {
            "estimator": outcome.estimator,
            "history_length": outcome.history_length,
            **(estimator_figures(outcome.scores, recording) if outcome.scores else {}),
            "rides": ride_figures(outcome.rides),
        }
        for name, outcome in outcomes.items()
    }
    one = {name: value[None] for name, value in probe.items()}
    latent = {"probe": _probe(one, recording.intrinsics), "effective_dimension": dimension}
    return without_nan(_plain({"recording": sizes, "latent": latent, "estimators": rows}))


def by_history(estimators: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the rows of each estimator that was trained on histories of several lengths, shortest first.

    Example:
        >>> rows = {"mlp": {"history_length": 10}, "mlp, 5 steps": {"history_length": 5}, "gru": {"history_length": 10}}
        >>> {name: row.setdefault("estimator", name.partition(",")[0]) for name, row in rows.items()}["mlp"]
        'mlp'
        >>> by_history(rows)["mlp"][0]["history_length"], list(by_history(rows))
        (5, ['mlp'])
    """
    names = dict.fromkeys(row["estimator"] for row in estimators.values() if row["estimator"])
    rows = {
        name: sorted((row for row in estimators.values() if row["estimator"] == name), key=itemgetter("history_length"))
        for name in names
    }
    return {name: found for name, found in rows.items() if len(found) > 1}


def own_length(estimators: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rows of references and of estimators that read histories of the run's length.

    Example:
        >>> list(own_length({"truth": {"estimator": None}, "mlp, 5 steps": {"estimator": "mlp"}}))
        ['truth']
    """
    return {name: row for name, row in estimators.items() if row["estimator"] in (None, name)}


def estimator_figures(scores: Sequence[Scores], recording: Recording) -> dict[str, Any]:
    """Return the figures of an estimator on the validation robots, each with ``value``, ``low`` and ``high``.

    Args:
        scores: of each training.
        recording: that they are of.

    Returns:
        ``error``: root mean square over all extrinsic states, in their standard deviations, and ``calibration`` of all
        of them; ``components``: ``rmse`` in SI units, ``r_squared`` and, with standard deviations, ``calibration`` of
        each; ``latent``: ``rmse`` (of the norm), ``r_squared``, ``calibration``, ``effective_dimension``; ``probe``: R²
        of the intrinsic ``parameters``, and their ``mean``; ``drift``: ``seconds`` and ``error`` by time in the ride;
        ``parameters``, ``microseconds`` a control step, ``trainings``.
    """
    got = {f.name: np.stack([np.asarray(getattr(each, f.name)) for each in scores]) for f in dataclasses.fields(Scores)}
    by_bin = got["steps"]
    steps = by_bin.sum(2)
    each_step, extrinsic, latent = steps[..., None], got["extrinsic"].sum(2), got["latent"].sum(2)
    relative = (got["extrinsic"] / got["scale"][:, None, None] ** 2).mean(-1)
    figures = {
        "rmse": interval(rmse, extrinsic, each_step),
        "r_squared": interval(r_squared, extrinsic, each_step, got["extrinsic_truth"], got["extrinsic_truth_squared"]),
    }
    if got["extrinsic_deviation"].shape[-1]:
        figures["calibration"] = interval(rmse, got["extrinsic_deviation"], each_step)
    return {
        "trainings": len(scores),
        "parameters": int(got["parameters"][0]),
        "microseconds": float(np.median(got["microseconds"])),
        "error": interval(rmse, relative.sum(2), steps),
        "components": [
            {**component._asdict(), **{name: _entry(figure, i) for name, figure in figures.items()}}
            for i, component in enumerate(recording.components)
        ],
        "calibration": _calibration(got["extrinsic_deviation"], steps),
        "latent": {
            "rmse": interval(rmse, latent.sum(-1), steps),
            "r_squared": interval(
                pooled_r_squared, latent, each_step, got["latent_truth"], got["latent_truth_squared"]
            ),
            "calibration": _calibration(got["latent_deviation"], steps),
            "effective_dimension": float(got["dimension"].mean()),
        },
        "probe": _probe(got, recording.intrinsics),
        "drift": {
            "seconds": (np.arange(by_bin.shape[2]) + 0.5) * got["bin_seconds"][0],
            **interval(rmse, relative, by_bin),
        },
    }


def _entry(figure: Mapping[str, Array], index: int) -> dict[str, Any]:
    return {name: values[index] for name, values in figure.items()}


def _calibration(deviation: Array, steps: Array) -> dict[str, Any] | None:
    """Return the root mean square of errors in estimated standard deviations; None without these."""
    size = deviation.shape[-1]
    return interval(rmse, deviation.sum(-1) / size, steps) if size else None


def _probe(sums: Mapping[str, Array], names: Sequence[str]) -> dict[str, Any]:
    """Return R² of each intrinsic parameter, and the mean over those that vary."""
    squared, truth, truth_squared = (sums[name] for name in ("probe", "probe_truth", "probe_truth_squared"))
    figure = interval(r_squared, squared, sums["probe_steps"][..., None], truth, truth_squared)
    known = figure["value"][np.isfinite(figure["value"])]
    mean = float(known.mean()) if known.size else None
    return {"mean": mean, "parameters": {name: _entry(figure, i) for i, name in enumerate(names)}}


def _plain(value: Any) -> Any:
    """Return nested dicts and lists with NumPy's arrays and numbers as Python's."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

"""Table V: errors of the estimators by component, with ideal and realistic sensors, beside the paper's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchrl_atr._errors import InputError
from torchrl_atr._text import markdown_table, with_unit
from torchrl_atr.evaluation import EstimationErrors
from torchrl_atr.evaluation.intervals import bootstrap
from torchrl_atr.reproduction.paper import LATENT_ERROR, PAIRS, STATE_ERRORS
from torchrl_atr.reproduction.policies import RiderPolicy
from torchrl_atr.reproduction.report import (
    FAILS,
    HOLDS,
    UNKNOWN,
    Claim,
    Job,
    missing_pairs,
    with_interval,
    write_report,
)
from torchrl_atr.reproduction.tracking import Grid, box_of, measure

SENSORS = ("ideal", "realistic")
LATENT = "latent"


def table5(job: Job, folder: Path, history_only: Sequence[RiderPolicy] = (), grid: Grid | None = None) -> Path:
    """Measure the estimation errors of every pair that has a policy; write ``table5.json``, the figure and the page.

    Args:
        job: policies, seed, and finished parts.
        folder: to write to.
        history_only: policies whose estimators read the history alone, to compare.
        grid: commands and trials; by default the job's.

    Raises:
        InputError: without a policy, and for a history-only one whose estimator reads more.
    """
    if not job.policies:
        raise InputError("Table V needs policies; give --policies RUN for each pair that you have")
    for policy in history_only:
        if policy.networks.estimator_inputs:
            read = ", ".join(map(str, policy.networks.estimator_inputs))
            raise InputError(f"--history-only {policy.folder}: its estimator also reads {read}; leave it out")
    rows: dict[str, dict[str, Any]] = {}
    box = ""
    for kind, policies in (("shipped", job.policies), ("history only", history_only)):
        for policy in policies:
            for sensors in SENSORS:
                result = measure(job, policy, grid, sensors)
                box = box_of(result)
                if result.estimators is not None:
                    rows.setdefault(policy.name, {})[f"{kind}, {sensors}"] = component_errors(result.estimators)
    if not rows:
        raise InputError("no policy estimates the extrinsic state, such as those whose actors read the history alone")
    _plot(rows, folder / "table5.png")
    text = (
        "Means ± standard deviations of |estimate - truth|, of the latent ‖ẑ - z‖, over all steps of the tracking "
        f"evaluation ({box}, test range) before a fall; brackets are intervals of the mean over robots. The paper does "
        "not say which pairs its row is of, nor with which sensors; the scale of the latent is learned, so its errors "
        "do not compare."
    )
    sections = [text, missing_pairs(rows, PAIRS), "![errors beside the paper's](table5.png)"]
    for pair, columns in rows.items():
        sections += [f"## {pair}", _table(columns)]
    claims = [_claim(pair, name, each) for pair, columns in rows.items() for name, each in columns.items()]
    paper = {LATENT: LATENT_ERROR, **STATE_ERRORS}
    return write_report(
        job,
        folder,
        "table5",
        "Table V: estimation errors",
        filter(None, sections),
        claims,
        pairs=rows,
        paper={name: {"mean": mean, "std": std} for name, (mean, std) in paper.items()},
    )


def component_errors(errors: EstimationErrors) -> dict[str, dict[str, Any]]:
    """Return label, unit, mean, standard deviation and interval of the mean by component, the latent first."""
    latent, states = errors.moments()
    found = {}
    if latent is not None and errors.latent is not None:
        low, high = bootstrap((errors.latent * errors.steps).ravel(), errors.steps.ravel())
        found[LATENT] = _entry("latent, norm", None, *latent, float(low), float(high))
    sums = (errors.extrinsic * errors.steps[..., None]).reshape(-1, len(states)).T
    lows, highs = bootstrap(sums, np.broadcast_to(errors.steps.ravel(), sums.shape))
    for (component, mean, std), low, high in zip(states, lows, highs):
        found[component.name] = _entry(component.label, component.unit, mean, std, float(low), float(high))
    return found


def _entry(label: str, unit: str | None, mean: float, std: float, low: float, high: float) -> dict[str, Any]:
    interval = [low, high] if np.isfinite([low, high]).all() else None
    return {"label": label, "unit": unit, "mean": mean, "std": std, "interval": interval}


def _table(columns: Mapping[str, Mapping[str, dict[str, Any]]]) -> str:
    paper = {LATENT: LATENT_ERROR, **STATE_ERRORS}
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    rows = []
    for name in names:
        one = next(column[name] for column in columns.values() if name in column)
        label = with_unit(one["label"], one["unit"])
        printed = "{:.4f} ± {:.4f}".format(*paper[name]) if name in paper else ""
        rows.append([label, printed, *(_cell(column.get(name)) for column in columns.values())])
    return markdown_table(["component", "paper", *columns], rows)


def _cell(entry: dict[str, Any] | None) -> str:
    if entry is None:
        return ""
    value, _, interval = with_interval(entry["mean"], entry["interval"], 4).partition(" ")
    return f"{value} ± {entry['std']:.4f} {interval}".strip()


def _claim(pair: str, name: str, entries: Mapping[str, dict[str, Any]]) -> Claim:
    compared = {key: entry["interval"] for key, entry in entries.items() if key in STATE_ERRORS}
    known = {key: interval for key, interval in compared.items() if interval is not None}
    labels = {key: entries[key]["label"] for key in known}
    above = [labels[key] for key, interval in known.items() if interval[0] > STATE_ERRORS[key][0]]
    below = [key for key, interval in known.items() if interval[1] <= STATE_ERRORS[key][0]]
    complete = len(known) == len(STATE_ERRORS)
    verdict = FAILS if above else HOLDS if complete and len(below) == len(known) else UNKNOWN
    return Claim(
        "Hidden states are estimated with low errors (Sec. V-D, Table V)",
        f"{pair}, {name}: share of the extrinsic states whose error is at most the paper's; all of them",
        len(below) / len(compared) if compared else None,
        None,
        verdict,
        f"Larger than the paper's: {', '.join(above)}" if above else "",
    )


def _plot(rows: Mapping[str, Mapping[str, Mapping[str, dict[str, Any]]]], path: Path) -> Path:
    from matplotlib import rc_context

    from torchrl_atr.evaluation.plotting import STYLE, save, subplots
    from torchrl_atr.evaluation.set_figures import line_styles

    curves = {f"{pair}, {name}": each for pair, columns in rows.items() for name, each in columns.items()}
    names = list(STATE_ERRORS)
    with rc_context(STYLE):
        figure, axis = subplots(figsize=(9, 4.4))
        axis.errorbar(*_points(names, STATE_ERRORS), fmt="_", color="black", ms=16, mew=2, label="paper", zorder=3)
        for i, ((label, entries), (colour, _)) in enumerate(zip(curves.items(), line_styles())):
            x = np.arange(len(names)) + 0.5 * ((i + 1) / (len(curves) + 1) - 0.5)
            y = [entries[name]["mean"] if name in entries else np.nan for name in names]
            axis.plot(x, y, "osD^v"[i % 5], color=colour, ms=4, label=label)
        axis.set(yscale="log", ylabel="mean |estimate - truth| [SI]", title="Estimation errors by component")
        labels = {name: entry["label"] for entries in curves.values() for name, entry in entries.items()}
        axis.set_xticks(range(len(names)), [labels.get(name, name) for name in names], rotation=55, ha="right")
        axis.grid(alpha=0.25)
        axis.legend(fontsize=7, ncols=2)
        return save(figure, path)


def _points(names: Sequence[str], errors: Mapping[str, tuple[float, float]]) -> tuple[Any, Any]:
    return np.arange(len(names)), np.array([errors[name][0] for name in names])

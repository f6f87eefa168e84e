"""Figures of an endurance evaluation: pure functions of an EnduranceResult, ready for JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchrl_atr.evaluation.access import Component
from torchrl_atr.evaluation.endurance import EnduranceResult
from torchrl_atr.evaluation.intervals import bootstrap, pooled_mean, wilson
from torchrl_atr.evaluation.metrics import without_nan

Array = NDArray[np.float64]
DRIFT_SECONDS = 10
"""Seconds at the start and at the end whose estimate errors are compared; at most half of the ride."""
_ROUNDING = 1e-6
SOON = {"since_push": 1.0, "since_command": 2.0}
"""Seconds after a push, and after a change of command, within which falls are counted."""
LATENT = Component("latent", "intrinsics' latent (norm)", "1")
HEADLINE_COMPONENTS = ("platform_velocity[0]", "body_velocity[0]")
"""Extrinsic states whose drift is the headline figure: the first of them that is estimated."""


def endurance_metrics(result: EnduranceResult) -> dict[str, Any]:
    """Return the contents of ``metrics.json`` of an endurance evaluation.

    ``survival``, the share of the ``n`` robots that are up at the end, and ``survival_over_time``, at every second,
    with Wilson's 95 % intervals; ``falls_per_minute`` of a robot that is up; ``settled_speed_error`` (m/s) and
    ``settled_yaw_error`` (rad/s), means over all steps after the settling time of each command, of robots that are up,
    with bootstrap intervals over robots, and ``errors_over_time``, the same second by second; ``falls_by_cause``;
    ``falls_after``, the number of falls soon after a push and a change of command, beside the share of the time that is
    as soon after one; ``fallen``, commands and intrinsic parameters of the fallen beside those of the others;
    ``estimates``, errors of the estimates in the first and the last seconds and their ratio, over the survivors, and
    ``estimate_drift``, the ratio for the platform's forward speed (for walking, the body's); ``do_nothing``, errors of
    a board that never moves. An entry ``..._interval`` is a 95 % interval. Entries without a value are None.

    Args:
        result: of :func:`~torchrl_atr.evaluation.evaluate_endurance`.

    Returns:
        Nested dicts of plain Python values without NaN.
    """
    n, falls = len(result.fall_time), int((~result.survived).sum())
    minutes = float(result.up_steps.sum()) * result.dt / 60.0
    estimates = estimate_drift(result)
    headline = next((row for name in HEADLINE_COMPONENTS for row in estimates if row["name"] == name), {})
    figures = {
        "protocol": "endurance",
        "n": n,
        "seconds": result.seconds,
        "command_seconds": result.command_seconds,
        "settle": result.settle,
        "push_seconds": result.push_seconds,
        "commands": {"low": result.bounds[0].tolist(), "high": result.bounds[1].tolist()},
        "overspeed": list(result.overspeed),
        "survival": (n - falls) / n,
        "survival_interval": list(wilson(n - falls, n)),
        "survival_over_time": survival_over_time(result),
        "falls": falls,
        "falls_per_minute": falls / minutes,
        **_settled_errors(result),
        "errors_over_time": errors_over_time(result),
        "falls_by_cause": falls_by_cause(result),
        "falls_after": falls_after(result),
        "fallen": compare_fallen(result),
        "estimates": estimates,
        "estimate_drift": headline.get("drift"),
        "estimate_drift_interval": headline.get("drift_interval"),
        "estimate_over_time": estimate_over_time(result),
        "do_nothing": do_nothing_baseline(result),
        "policy_reads": list(result.policy_reads),
    }
    return without_nan(figures)


def survival_over_time(result: EnduranceResult) -> dict[str, list[float]]:
    """Return the share of robots that are up at every second and at the end, with Wilson's intervals.

    Returns:
        ``seconds``, ``share``, ``low`` and ``high``.
    """
    n = len(result.fall_time)
    times = np.unique([*np.arange(math.floor(result.seconds + _ROUNDING) + 1), result.seconds])
    up = [n - int((result.fall_time <= time + _ROUNDING).sum()) for time in times]
    low, high = np.transpose([wilson(count, n) for count in up]).tolist()
    return {"seconds": times.tolist(), "share": [count / n for count in up], "low": low, "high": high}


def _settled_errors(result: EnduranceResult) -> dict[str, Any]:
    sums, counts = settled_sums(result)
    sums, counts = sums.sum(0), counts.sum(0)
    figures: dict[str, Any] = {}
    low, high = bootstrap(sums, counts)
    for axis, (name, mean) in enumerate(zip(("speed", "yaw"), pooled_mean(sums, counts))):
        figures[f"settled_{name}_error"] = float(mean)
        figures[f"settled_{name}_error_interval"] = [float(low[axis]), float(high[axis])]
    return figures


def settled_sums(result: EnduranceResult) -> tuple[Array, Array]:
    """Return sums of the errors over settled steps and the number of these steps, (S, 2, n) each."""
    counts = np.repeat(result.settled_steps[:, None], 2, axis=1)
    errors = result.settled_error.swapaxes(1, 2)
    return np.where(counts > 0, errors * counts, 0.0), counts


def errors_over_time(result: EnduranceResult) -> dict[str, Any]:
    """Return the settled errors of each second that has any, with bootstrap intervals over robots.

    Returns:
        ``seconds`` (midpoints), and for ``speed`` and ``yaw`` the ``mean``, ``low`` and ``high``.
    """
    sums, counts = settled_sums(result)
    some = counts.sum((1, 2)) > 0
    sums, counts = sums[some], counts[some]
    mean, (low, high) = pooled_mean(sums, counts), bootstrap(sums, counts)
    seconds = _middles(result)[some]
    curves: dict[str, Any] = {"seconds": seconds.tolist()}
    for axis, name in enumerate(("speed", "yaw")):
        curves[name] = {"mean": mean[:, axis].tolist(), "low": low[:, axis].tolist(), "high": high[:, axis].tolist()}
    return curves


def _middles(result: EnduranceResult) -> Array:
    """Return the midpoints of the seconds, (S,); the last second may be shorter."""
    starts = np.arange(len(result.up_steps), dtype=np.float64)
    return (starts + np.minimum(starts + 1.0, result.seconds)) / 2.0


def falls_by_cause(result: EnduranceResult) -> dict[str, Any]:
    """Return the number of ``falls`` by cause, the most frequent first, their ``share`` of the robots, its interval."""
    n = len(result.fall_time)
    names, counts = np.unique(result.fall_cause[~result.survived], return_counts=True)
    by_cause = sorted(zip(names.tolist(), counts.tolist()), key=lambda pair: (-pair[1], pair[0]))
    return {name: {"falls": c, "share": c / n, "share_interval": list(wilson(c, n))} for name, c in by_cause}


def falls_after(result: EnduranceResult) -> dict[str, Any]:
    """Count the falls within the seconds of :data:`SOON` after a push and after a change of command.

    Returns:
        For ``push`` and ``command``: ``within`` (seconds), ``falls``, their ``share`` of all falls and its interval,
        ``expected``, the share of the ride's time that is as soon after one, and the ``median`` (seconds) of all falls.
    """
    falls, entries = int((~result.survived).sum()), {}
    intervals = {"since_push": result.push_seconds, "since_command": result.command_seconds}
    for name, within in SOON.items():
        since = getattr(result, name)
        known = since[np.isfinite(since)]
        soon = int((known <= within + _ROUNDING).sum())
        entries[name.removeprefix("since_")] = {
            "within": within,
            "falls": soon,
            "share": soon / falls if falls else math.nan,
            "share_interval": list(wilson(soon, falls)),
            "expected": _share_after(result.seconds, intervals[name], within, first=name == "since_command"),
            "median": float(np.median(known)) if known.size else math.nan,
        }
    return entries


def _share_after(seconds: float, interval: float, within: float, first: bool) -> float:
    """Return the share of a ride that is soon after one of its events, of which the ``first`` may be at its start."""
    if math.isnan(interval):
        return math.nan
    events = math.ceil(seconds / interval - _ROUNDING) - (not first)
    return min(1.0, events * min(within, interval) / seconds)


def compare_fallen(result: EnduranceResult) -> dict[str, Any]:
    """Compare the fallen with the survivors: commands at the fall, and intrinsic parameters.

    Returns:
        ``speed_command`` and ``yaw_command``: mean |c_v| and |c_ω| at the falls, and over all commands.
        ``intrinsics``: by parameter, means of ``fallen`` and ``up`` in units of half the training range, and their
        ``difference``, with a 95 % interval (normal approximation); those that differ most come first.
    """
    down = ~result.survived
    number = np.minimum((result.fall_time[down] - _ROUNDING) // result.command_seconds, len(result.commands) - 1)
    at_fall = np.abs(result.commands[number.astype(int), down.nonzero()[0]])
    overall = np.abs(result.commands).mean((0, 1))
    figures: dict[str, Any] = {
        name: {"fallen": _mean(at_fall[:, axis]), "all": float(overall[axis])}
        for axis, name in enumerate(("speed_command", "yaw_command"))
    }
    rows = []
    for index, name in enumerate(result.intrinsic_names):
        fallen, up = (result.intrinsics[chosen, index] for chosen in (down, ~down))
        difference, half = _mean(fallen) - _mean(up), 1.96 * math.hypot(_error(fallen), _error(up))
        interval = [difference - half, difference + half]
        row = {"fallen": _mean(fallen), "up": _mean(up), "difference": difference, "difference_interval": interval}
        rows.append((-abs(difference) / half if half > 0 else 0.0, name, row))
    figures["intrinsics"] = {name: row for _, name, row in sorted(rows, key=lambda each: each[0])}
    return figures


def _mean(values: Array) -> float:
    return float(values.mean()) if values.size else math.nan


def _error(values: Array) -> float:
    """Compute the standard error of a mean; NaN for fewer than two values."""
    return float(values.std(ddof=1)) / math.sqrt(values.size) if values.size > 1 else math.nan


def estimate_errors(result: EnduranceResult) -> list[tuple[Component, Array]]:
    """Return each estimated component and its error by second and robot, (S, n); empty without estimates."""
    pairs = []
    if result.estimate_error is not None:
        pairs += list(zip(result.components, np.moveaxis(result.estimate_error, -1, 0)))
    if result.latent_error is not None:
        pairs.append((LATENT, result.latent_error))
    return pairs


def estimate_drift(result: EnduranceResult) -> list[dict[str, Any]]:
    """Compute for each estimate its mean error in the ``first`` and the ``last`` seconds, and their ratio, ``drift``.

    Both are of the survivors, so that the robots are the same; empty for a ride of one second, or without survivors.
    ``window``: number of seconds.
    """
    window, up = min(DRIFT_SECONDS, len(result.up_steps) // 2), result.survived
    if window < 1 or not up.any():
        return []
    weights, rows = result.up_steps[:, up], []
    for component, error in estimate_errors(result):
        sums = error[:, up] * weights
        first, last = (sums[part].sum(0) / weights[part].sum(0) for part in (slice(window), slice(-window, None)))
        low, high = bootstrap(last, first)
        rows.append(
            {
                **component._asdict(),
                "window": window,
                "first": _mean(first),
                "last": _mean(last),
                "drift": float(pooled_mean(last, first)),
                "drift_interval": [float(low), float(high)],
            }
        )
    return rows


def estimate_over_time(result: EnduranceResult) -> dict[str, Any] | None:
    """Return the error of the headline estimate by second, over the robots that are up, with bootstrap intervals.

    Returns:
        ``label``, ``unit``, ``seconds`` (midpoints), ``mean``, ``low`` and ``high``; None if it is not estimated.
    """
    by_name = {component.name: (component, error) for component, error in estimate_errors(result)}
    name = next((name for name in HEADLINE_COMPONENTS if name in by_name), None)
    if name is None:
        return None
    component, error = by_name[name]
    some = result.up_steps.sum(-1) > 0
    counts = result.up_steps[some]
    sums = np.where(counts > 0, error[some] * counts, 0.0)
    low, high = bootstrap(sums, counts)
    return {
        "label": component.label,
        "unit": component.unit,
        "seconds": _middles(result)[some].tolist(),
        "mean": pooled_mean(sums, counts).tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
    }


def do_nothing_baseline(result: EnduranceResult) -> dict[str, float]:
    """Return the figures of a board that never moves: nobody falls, by definition, and every error is the command."""
    speed, yaw = np.abs(result.commands).mean((0, 1))
    return {"survival": 1.0, "settled_speed_error": float(speed), "settled_yaw_error": float(yaw)}

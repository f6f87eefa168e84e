"""Figures of an evaluation: pure functions of a TrackingResult, ready for JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchrl_atr.evaluation.envelope import SETTLED_YAW_ERROR
from torchrl_atr.evaluation.tracking import TrackingResult

Array = NDArray[np.float64]
EPSILONS: tuple[float, ...] = tuple(round(0.05 * i, 2) for i in range(21))
"""Error thresholds of the command area, m/s and rad/s."""
STRAIGHT_SPEED, STEERING_YAW = 2.0, 1.0
"""Largest |c_v| of ``settled_speed_error_straight`` (c_ω = 0) and largest |c_ω| of ``yaw_slope``."""
MASTERED = (0.5, SETTLED_YAW_ERROR)
"""Largest settled errors at which a command counts as mastered, m/s and rad/s."""
_TOLERANCE = 1e-6


def tracking_metrics(result: TrackingResult, epsilons: Sequence[float] = EPSILONS) -> dict[str, Any]:
    """Return the contents of ``metrics.json``.

    ``protocol``; ``n`` trials; ``survival``, their share without a fall; ``settled_speed_error`` (m/s) and
    ``settled_yaw_error`` (rad/s), means over the survivors of all commands; ``settled_speed_error_straight``,
    the same over |c_v| <= 2 at c_ω = 0; ``rms_speed_error`` and ``rms_yaw_error``, means over all trials, up
    to the fall; ``yaw_slope``, the regression slope (with intercept) of settled ω on c_ω over survivors with
    |c_ω| <= 1, and ``yaw_slope_by_speed``; ``commands_mastered``, the share of the commands at which most robots
    stay up and settle within :data:`MASTERED`; ``commands_mastered_of_envelope``, the same of those commands that can
    be followed at all; ``command_area`` (:func:`command_area`); ``do_nothing``, the same figures for a board that never
    moves; ``envelope`` (:func:`envelope_table`); ``estimator_errors`` (Table V). Entries without a value (no survivors,
    a single yaw command, a task without an envelope) are None.

    Args:
        result: of :func:`~torchrl_atr.evaluation.evaluate_tracking`.
        epsilons: thresholds of the command area.

    Returns:
        Nested dicts of plain Python values without NaN.
    """
    figures = {
        "protocol": "tracking",
        "n": int(result.fall_time.size),
        "commands": int(result.fall_time[..., 0].size),
        "robots_per_command": int(result.fall_time.shape[-1]),
        "seconds": result.seconds,
        "settle": result.settle,
        **_figures(result, epsilons),
        "do_nothing": _figures(do_nothing_baseline(result), epsilons),
        "envelope": envelope_table(result),
        "estimator_errors": estimator_table(result),
        "policy_reads": list(result.policy_reads),
    }
    return without_nan(figures)


def do_nothing_baseline(result: TrackingResult) -> TrackingResult:
    """Return the result of a board that never moves: every error is the command, and nobody falls, by definition."""
    shape = result.fall_time.shape
    speed = np.broadcast_to(np.abs(result.speed_commands)[:, None, None], shape)
    yaw = np.broadcast_to(np.abs(result.yaw_commands)[None, :, None], shape)
    return replace(
        result,
        rms_speed_error=speed,
        rms_yaw_error=yaw,
        settled_speed_error=speed,
        settled_yaw_error=yaw,
        settled_speed=np.zeros(shape),
        settled_yaw_rate=np.zeros(shape),
        fall_time=np.full(shape, math.nan),
        policy_reads=(),
        estimators=None,
    )


def _figures(result: TrackingResult, epsilons: Sequence[float]) -> dict[str, Any]:
    up = result.survived
    slow = _within(result.speed_commands, STRAIGHT_SPEED)[:, None, None]
    straight = up & slow & _within(result.yaw_commands, 0.0)[:, None]
    steering = up & _within(result.yaw_commands, STEERING_YAW)[:, None]
    yaw = np.broadcast_to(result.yaw_commands[None, :, None], up.shape)

    def slope(chosen: NDArray[np.bool_]) -> float:
        return regression_slope(yaw[chosen], result.settled_yaw_rate[chosen])

    rows = enumerate(result.speed_commands)
    mastered = mastered_commands(result)
    return {
        "survival": float(up.mean()),
        "settled_speed_error": _mean(result.settled_speed_error[up]),
        "settled_speed_error_straight": _mean(result.settled_speed_error[straight]),
        "settled_yaw_error": _mean(result.settled_yaw_error[up]),
        "rms_speed_error": _mean(result.rms_speed_error),
        "rms_yaw_error": _mean(result.rms_yaw_error),
        "yaw_slope": slope(steering),
        "yaw_slope_by_speed": {f"{v:g}": slope(steering & _only(i, up.shape)) for i, v in rows},
        "commands_mastered": float(mastered.mean()),
        "commands_mastered_of_envelope": _share_of_envelope(mastered, result),
        "command_area": command_area(result, epsilons),
    }


def mastered_commands(result: TrackingResult) -> NDArray[np.bool_]:
    """Return a mask of the commands at which most robots stay up and settle within :data:`MASTERED`, (V, W)."""
    near = (result.settled_speed_error <= MASTERED[0]) & (result.settled_yaw_error <= MASTERED[1])
    return (result.survived & near).mean(-1) > 0.5


def envelope_table(result: TrackingResult) -> dict[str, Any] | None:
    """Return the bounds of any policy on the evaluated commands; None for a task without an envelope.

    Returns:
        ``commands``, the share of the commands that it follows within 0.3 rad/s under the task's reward; ``friction``,
        the share that friction alone allows; and the numbers of :class:`~torchrl_atr.evaluation.envelope.Envelope`.
    """
    if result.envelope is None:
        return None
    commands = result.speed_commands, result.yaw_commands
    shares = {"commands": _followed(result), "friction": result.envelope.follows(*commands, False, MASTERED[1])}
    return {**{name: float(held.mean()) for name, held in shares.items()}, **asdict(result.envelope)}


def envelope_curve(result: TrackingResult, epsilons: Sequence[float] = EPSILONS) -> list[float] | None:
    """Compute the share of the commands that the best policy follows within ε rad/s, by ε; None without an envelope."""
    if result.envelope is None:
        return None
    error = result.envelope.yaw_error(result.speed_commands, result.yaw_commands)
    return _area_curve(error, np.ones(error.shape, dtype=bool), epsilons)


def _share_of_envelope(chosen: NDArray[np.bool_], result: TrackingResult) -> float | None:
    """Compute the share of the commands within the envelope that are chosen."""
    return None if result.envelope is None else _mean(chosen[_followed(result)].astype(np.float64))


def _followed(result: TrackingResult) -> NDArray[np.bool_]:
    assert result.envelope is not None
    return result.envelope.follows(result.speed_commands, result.yaw_commands, error=MASTERED[1])


def command_area(result: TrackingResult, epsilons: Sequence[float] = EPSILONS) -> dict[str, Any]:
    """Compute the share of trials whose error is at most ε, as curves over ε (questions A28, A29).

    A trial that fell is outside every ε. ``rms`` is over the whole trial from rest, as in the paper,
    ``settled`` is the mean absolute error after the settling time; ``combined`` is √(e_v² + e_ω²). A share
    times ``total``, the area of the evaluated box in (m/s)(rad/s), is the area itself.
    """
    errors = {
        "rms": (result.rms_speed_error, result.rms_yaw_error),
        "settled": (result.settled_speed_error, result.settled_yaw_error),
    }
    area: dict[str, Any] = {"epsilon": [float(e) for e in epsilons]}
    for kind, (speed, yaw) in errors.items():
        parts = {"speed": speed, "yaw": yaw, "combined": np.hypot(speed, yaw)}
        area[kind] = {name: _area_curve(e, result.survived, epsilons) for name, e in parts.items()}
    area["total"] = float(np.ptp(result.speed_commands) * np.ptp(result.yaw_commands))
    return area


def _area_curve(error: Array, survived: NDArray[np.bool_], epsilons: Sequence[float]) -> list[float]:
    return [float((survived & (error <= epsilon)).mean()) for epsilon in epsilons]


def regression_slope(x: Array, y: Array) -> float:
    """Compute the least-squares slope of y on x with an intercept; NaN if x does not vary.

    Example:
        >>> regression_slope(np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0, 5.0]))
        2.0
    """
    deviation = x - x.mean() if x.size else x
    square = float((deviation**2).sum())
    return float((deviation * y).sum() / square) if square > _TOLERANCE else math.nan


def estimator_table(result: TrackingResult) -> dict[str, Any] | None:
    """Return Table V: mean and standard deviation of ‖ẑ - z‖ and of |x̂ - x| by component; None without estimates."""
    if result.estimators is None:
        return None
    latent, extrinsic = result.estimators.moments()
    rows = []
    for component, mean, std in extrinsic:
        rows.append({**component._asdict(), "mean": mean, "std": std})
    norm = None
    if latent is not None:
        norm = {"label": "intrinsics' latent (norm)", "unit": "1", "mean": latent[0], "std": latent[1]}
    return {"latent": norm, "extrinsic": rows}


def _within(commands: Array, limit: float) -> NDArray[np.bool_]:
    return np.abs(commands) <= limit + _TOLERANCE


def _only(row: int, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    mask = np.zeros(shape, dtype=bool)
    mask[row] = True
    return mask


def _mean(values: Array) -> float:
    return float(values.mean()) if values.size else math.nan


def without_nan(value: Any) -> Any:
    """Return ``value`` with every number that JSON cannot write replaced by None."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

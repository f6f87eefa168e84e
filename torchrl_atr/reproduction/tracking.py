"""Tracking over the paper's command space: measured once for each policy and set of sensors, for several figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchrl_atr._errors import InputError
from torchrl_atr.evaluation import (
    TrackingResult,
    command_grid,
    evaluate_tracking,
    load_tracking,
    mastered_range,
    save_tracking,
)
from torchrl_atr.evaluation.intervals import mean_interval, wilson
from torchrl_atr.evaluation.metrics import mastered_commands
from torchrl_atr.reproduction.policies import RiderPolicy
from torchrl_atr.reproduction.report import Job

Array = NDArray[np.float64]
EPSILONS = tuple(round(0.1 * i, 1) for i in range(51))
"""Error thresholds of the command area, m/s and rad/s: root mean squares from rest are large at 15 m/s."""
THRESHOLD = 1.0
"""Threshold of the command areas in tables and claims."""


class Grid(NamedTuple):
    """Commands and trials; by default the paper's: 12,341 commands, one robot each, 10 s from rest."""

    max_speed: float = 15.0
    max_yaw_rate: float = 2.0
    speed_step: float = 0.1
    yaw_rate_step: float = 0.1
    robots: int = 1
    seconds: float = 10.0
    settle: float = 5.0


def grid_of(job: Job, max_speed: float | None = None, max_yaw_rate: float | None = None) -> Grid:
    """Return the grid of a job: the paper's, or some 30 commands of two robots if it is quick.

    Args:
        job: the request.
        max_speed: largest |c_v| of another command space, m/s.
        max_yaw_rate: largest |c_ω|, rad/s.
    """
    grid = Grid()
    speed, yaw_rate = max_speed or grid.max_speed, max_yaw_rate or grid.max_yaw_rate
    if job.quick:
        return Grid(speed, yaw_rate, speed / (2 if speed % 3 else 3), yaw_rate / 2, robots=2)  # round numbers
    return grid._replace(max_speed=speed, max_yaw_rate=yaw_rate)


def measure(
    job: Job, policy: RiderPolicy, grid: Grid | None = None, sensors: str | None = None, robot: str | None = None
) -> TrackingResult:
    """Measure a policy's tracking in the test range of the intrinsic parameters, or load what was measured.

    Args:
        job: seed, and finished parts.
        policy: of a pair.
        grid: by default the job's.
        sensors: a registered set; None for the run's.
        robot: another one to ride with; None for the policy's own.

    Raises:
        InputError: for a policy of another task than riding.
    """
    if not policy.rides:
        raise InputError(f"{policy.folder} is of the task {policy.config.task.name!r}; give a policy that rides")
    grid = grid or grid_of(job)
    chosen: dict[str, Any] = {"sensors": sensors or policy.config.task.sensors}
    chosen |= {} if robot is None else {"robot": robot}
    asked = {"policy": policy.fingerprint, "seed": job.seed, **grid._asdict(), **chosen}

    def make(part: Path) -> None:
        commands = command_grid(grid.max_speed, grid.max_yaw_rate, grid.speed_step, grid.yaw_rate_step)
        with job.progress(" ".join([policy.name, *chosen.values()])) as progress:
            result = evaluate_tracking(
                policy.policy,
                policy.envs(randomization="test", **chosen),
                commands,
                grid.robots,
                grid.seconds,
                grid.settle,
                job.seed,
                encoder_module=policy.networks.encoder_module,
                progress=progress,
            )
        save_tracking(result, part / "tracking.npz")

    return load_tracking(job.parts.get(f"tracking-{policy.name}", asked, make) / "tracking.npz")


def box_of(result: TrackingResult) -> str:
    """Return the command space of a result as text."""
    speed, yaw_rate = (float(np.abs(axis).max()) for axis in (result.speed_commands, result.yaw_commands))
    return f"±{speed:g} m/s × ±{yaw_rate:g} rad/s"


def combined_error(result: TrackingResult) -> Array:
    """Compute each trial's √(e_v² + e_ω²) of root mean squares, (V, W, R).

    A trial that fell has at least the error of a board that never moves, so that falling early does not pay.
    """
    error = np.hypot(result.rms_speed_error, result.rms_yaw_error)
    return np.where(result.survived, error, np.maximum(error, still_error(result)))


def still_error(result: TrackingResult) -> Array:
    """Compute the same of a board that never moves: the size of the command, (V, W, R)."""
    size = np.hypot(result.speed_commands[:, None], result.yaw_commands[None])
    return np.broadcast_to(size[..., None], result.fall_time.shape)


def within(result: TrackingResult, threshold: float = THRESHOLD) -> NDArray[np.bool_]:
    """Return the trials without a fall whose combined error is at most ``threshold``, (V, W, R)."""
    return result.survived & (combined_error(result) <= threshold)


def tracking_figures(result: TrackingResult) -> dict[str, Any]:
    """Compute the figures of a pair's table, with 95 % intervals over trials.

    Returns:
        Values and their ``NAME_interval``: ``survival``; ``rms_speed_error`` (m/s) and ``rms_yaw_error`` (rad/s), up to
        a fall; ``area``, the share of trials within :data:`THRESHOLD`; ``still_area``, that of a board that never
        moves; ``mastered``, the share of commands at which most robots stay up and settle within 0.5 m/s and 0.3 rad/s,
        and ``mastered_range``, the largest range in which 95 % are; ``envelope``, the share that can be followed at
        all; ``n``.
    """
    n, up, area = result.fall_time.size, int(result.survived.sum()), int(within(result).sum())
    figures: dict[str, Any] = {
        "n": n,
        "survival": up / n,
        "survival_interval": list(wilson(up, n)),
        "area": area / n,
        "area_interval": list(wilson(area, n)),
        "still_area": float((still_error(result) <= THRESHOLD).mean()),
        "mastered": float(mastered_commands(result).mean()),
        "mastered_range": None if (limits := mastered_range(result)) is None else vars(limits),
        "envelope": None,
    }
    for name in ("rms_speed_error", "rms_yaw_error"):
        value, interval = mean_interval(getattr(result, name).ravel())
        figures |= {name: value, f"{name}_interval": None if interval is None else list(interval)}
    if result.envelope is not None:
        held = result.envelope.follows(result.speed_commands, result.yaw_commands)
        figures["envelope"] = float(held.mean())
    return figures

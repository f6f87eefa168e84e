"""Figure 6: a manual sequence of commands, the achieved and the estimated velocity of the transporter over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic
from torchrl_atr._text import markdown_table
from torchrl_atr.evaluation.command_file import check_commands, duration, read_commands
from torchrl_atr.evaluation.intervals import bootstrap, mean_interval, pooled_mean, wilson
from torchrl_atr.evaluation.sequence import SequenceResult, evaluate_sequence
from torchrl_atr.evaluation.video import Command
from torchrl_atr.reproduction.policies import RiderPolicy
from torchrl_atr.reproduction.report import Claim, Job, judge, with_interval, write_report
from torchrl_atr.training import commanded_range

Array = NDArray[np.float64]
EXPLAINED = 0.9
"""Share of the velocity's variance that estimates must explain for the claim to hold."""
_NAMES = {"speed": "m/s", "yaw_rate": "rad/s"}


class Sizes(NamedTuple):
    """Number of robots, and the longest ride, s."""

    robots: int = 50
    seconds: float = float("inf")


QUICK = Sizes(robots=4, seconds=12.0)


def figure6(job: Job, folder: Path, commands: str | Path = "figure6", sizes: Sizes | None = None) -> Path:
    """Ride a sequence of commands with each policy; write figures, arrays, ``figure6.json`` and the page.

    Args:
        job: policies, seed, and finished parts.
        folder: to write to.
        commands: a file, see :func:`~torchrl_atr.evaluation.command_file.read_commands`.
        sizes: by default the job's.

    Raises:
        InputError: for a wrong file, or commands that no policy takes; before anything is simulated.
    """
    sizes = sizes or (QUICK if job.quick else Sizes())
    sequence = read_commands(commands)
    if not job.policies:
        raise InputError("Figure 6 needs a policy; give --policies RUN")
    refused = {policy.name: reason for policy in job.policies if (reason := _refusal(sequence, policy))}
    riding = [policy for policy in job.policies if policy.name not in refused]
    if not riding:
        raise InputError("; ".join(refused.values()))
    seconds = min(duration(sequence), sizes.seconds)
    sections, rows, claims = [], [], []
    for policy in riding:
        result = _ride(job, policy, sequence, seconds, sizes.robots)
        figures = sequence_figures(result)
        rows.append({"pair": policy.name, "robots": result.up.shape[1], "seconds": seconds, **figures})
        claims.append(_claim(policy.name, figures))
        image = _plot(result, folder / f"{policy.name}.png", policy.name)
        save_sequence(result, folder / f"{policy.name}.npz")
        sections.append(f"![commanded, achieved and estimated velocity, {policy.name}]({image.name})")
    text = (
        f"Commands of `{commands}`; intrinsics of the test range, the sensors of the training. Lines: one robot that "
        "stayed up longest; bands: the middle 90 % of the robots that are up. Tracking errors are root mean squares "
        "over the ride of achieved - asked. Velocities are estimated in the body frame, which tilts with the robot, "
        "and errors of estimates, means of |estimate - truth|, are against that. A robot counts until it falls. The "
        "paper prints no number."
    )
    left_out = [f"Not measured: {reason}." for reason in refused.values()]
    return write_report(
        job,
        folder,
        "figure6",
        "Figure 6: a manual sequence of commands",
        [text, _table(rows), *left_out, *sections],
        claims,
        pairs=rows,
    )


def _refusal(sequence: tuple[Command, ...], policy: RiderPolicy) -> str:
    """Return why a policy does not take the commands; empty if it does."""
    limits = commanded_range(policy.config, policy.networks)
    if limits is not None:
        try:
            check_commands(sequence, limits)
        except InputError as error:
            return f"{policy.name}, {policy.folder}: {error}"
    return ""


def _ride(job: Job, policy: RiderPolicy, sequence: tuple[Command, ...], seconds: float, robots: int) -> SequenceResult:
    asked = {"policy": policy.fingerprint, "commands": sequence, "seconds": seconds, "robots": robots, "seed": job.seed}

    def make(part: Path) -> None:
        with job.progress(policy.name) as progress:
            envs = policy.envs(randomization="test")
            result = evaluate_sequence(policy.policy, envs, sequence, seconds, robots, seed=job.seed, progress=progress)
        save_sequence(result, part / "sequence.npz")

    return load_sequence(job.parts.get(f"sequence-{policy.name}", asked, make) / "sequence.npz")


def save_sequence(result: SequenceResult, path: Path) -> None:
    """Write a ride as an ``.npz`` file in single precision; :func:`load_sequence` reads it back."""
    arrays = {name: value for name, value in vars(result).items() if value is not None}
    single = {name: value if value.dtype == bool else value.astype(np.float32) for name, value in arrays.items()}
    with atomic(path) as file:
        np.savez_compressed(file, **single)  # type: ignore[arg-type]


def load_sequence(path: Path) -> SequenceResult:
    """Read a file of :func:`save_sequence`."""
    with np.load(path) as file:
        arrays = {
            name: file[name] if file[name].dtype == bool else file[name].astype(np.float64) for name in file.files
        }
    return SequenceResult(**{"estimated": None, "true": None, **arrays})


def sequence_figures(result: SequenceResult) -> dict[str, Any]:
    """Compute survival, tracking and estimation errors of a ride, with 95 % intervals over robots.

    Returns:
        ``survival`` with ``survival_interval``, and for ``speed`` and ``yaw_rate`` values with ``_interval``:
        ``NAME_rms``, root mean square of achieved - asked; ``NAME_estimate_error``, mean |estimate - truth|, and
        ``NAME_explained``, the share of the truth's variance that estimates explain; None without estimates.
    """
    up = result.up[..., None]
    n, steps = result.up.shape[1], result.up.sum(0).astype(np.float64)
    share = result.survived.sum()
    figures: dict[str, Any] = {"survival": float(share) / n, "survival_interval": list(wilson(int(share), n))}
    squared = np.where(up, (result.achieved - result.asked[:, None]) ** 2, 0.0).sum(0)
    for i, name in enumerate(_NAMES):
        rms, interval = mean_interval(np.sqrt(squared[:, i] / steps))
        figures |= _entry(f"{name}_rms", rms, interval)
        if result.estimated is None or result.true is None:
            figures |= _entry(f"{name}_estimate_error", None, None) | _entry(f"{name}_explained", None, None)
            continue
        error, truth = (result.estimated - result.true)[..., i], result.true[..., i]
        total = np.where(result.up, np.abs(error), 0.0).sum(0)
        figures |= _pooled(f"{name}_estimate_error", total, steps)
        mean = truth[result.up].mean()
        wrong, varied = (np.where(result.up, each**2, 0.0).sum(0) for each in (error, truth - mean))
        value, (low, high) = 1.0 - float(pooled_mean(wrong, varied)), bootstrap(wrong, varied)
        known = np.isfinite([low, high]).all()
        figures |= _entry(f"{name}_explained", value, (1.0 - float(high), 1.0 - float(low)) if known else None)
    return figures


def _pooled(name: str, total: Array, steps: Array) -> dict[str, Any]:
    low, high = bootstrap(total, steps)
    interval = (float(low), float(high)) if np.isfinite([low, high]).all() else None
    return _entry(name, float(pooled_mean(total, steps)), interval)


def _entry(name: str, value: float | None, interval: tuple[float, float] | None) -> dict[str, Any]:
    return {name: value, f"{name}_interval": None if interval is None else list(interval)}


def _claim(pair: str, figures: dict[str, Any]) -> Claim:
    value, interval = figures["speed_explained"], figures["speed_explained_interval"]
    return Claim(
        "The estimator predicts the continuously changing velocity of the transporter (Sec. V-D, Fig. 6)",
        f"{pair}: share of the forward velocity's variance that the estimates explain is above {EXPLAINED:g}",
        value,
        interval,
        judge(interval, EXPLAINED),
        "" if value is not None else "The policy estimates no velocity",
    )


def _table(rows: list[dict[str, Any]]) -> str:
    head = ["pair", "robots", "up at the end", "speed error, m/s", "yaw rate error, rad/s"]
    head += ["estimate of speed off by, m/s", "of yaw rate, rad/s", "explained, speed", "yaw rate"]
    names = ["speed_rms", "yaw_rate_rms", "speed_estimate_error", "yaw_rate_estimate_error", "speed_explained"]
    cells = [
        [
            row["pair"],
            str(row["robots"]),
            with_interval(row["survival"], row["survival_interval"], 2),
            *(with_interval(row[name], row[f"{name}_interval"]) for name in (*names, "yaw_rate_explained")),
        ]
        for row in rows
    ]
    return markdown_table(head, cells)


def _plot(result: SequenceResult, path: Path, title: str) -> Path:
    from matplotlib import rc_context

    from torchrl_atr.evaluation.plotting import GREY, PALETTE, STYLE, save, subplots

    shown = int(np.argmax(result.up.sum(0)))
    with rc_context(STYLE):
        figure, axes = subplots(2, 1, figsize=(9, 4.6), sharex=True)
        for i, (axis, label) in enumerate(zip(axes, ("forward speed [m/s]", "yaw rate [rad/s]"))):
            command = result.command[:, shown, i]
            if np.abs(command - result.asked[:, i]).max() > 1e-6 + 1e-3 * np.abs(command).max():
                axis.plot(result.time, result.asked[:, i], color=GREY, lw=1.2, ls=":", label="asked for")
            axis.plot(result.time, command, color="black", lw=1.2, label="commanded")
            for name, values, colour, dashes in _curves(result):
                one = np.where(result.up[:, shown], values[:, shown, i], np.nan)
                axis.plot(result.time, one, color=colour, ls=dashes, lw=1.2, label=name)
            if result.up.shape[1] > 1:
                low, high = _middle(result.achieved[..., i], result.up)
                axis.fill_between(result.time, low, high, color=PALETTE[0], alpha=0.15, lw=0)
            axis.set(ylabel=label, xlim=(0.0, result.time[-1]))
            axis.grid(alpha=0.25)
        axes[0].set_title(f"{title}, {result.survived.sum()} of {result.up.shape[1]} robots up at the end")
        axes[1].set_xlabel("time [s]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
        return save(figure, path)


def _curves(result: SequenceResult) -> list[tuple[str, Array, str, Any]]:
    """Return label, values, colour and dashes of the curves of one robot."""
    from torchrl_atr.evaluation.plotting import PALETTE

    curves: list[tuple[str, Array, str, Any]] = [("actual", result.achieved, PALETTE[0], "-")]
    if result.true is not None and result.estimated is not None:
        curves.append(("actual, in the body frame", result.true, PALETTE[2], "-"))
        curves.append(("estimated, in the body frame", result.estimated, PALETTE[1], (0, (4, 1.5))))
    return curves


def _middle(values: Array, up: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the 5 % and 95 % quantiles over the robots that are up, (T,) each; NaN where there is none."""
    masked = np.where(up, values, np.nan)
    masked[~up.any(1)] = 0.0  # no warning of an empty slice
    low, high = np.nanquantile(masked, [0.05, 0.95], axis=1)
    some = up.any(1)
    return np.where(some, low, np.nan), np.where(some, high, np.nan)

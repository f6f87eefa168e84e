"""Figure 4: tracking errors over the command space, and command areas, of the eight pairs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torchrl_atr._errors import InputError
from torchrl_atr._text import markdown_table
from torchrl_atr.evaluation import TrackingResult, command_area
from torchrl_atr.evaluation.intervals import bootstrap_difference, mean_interval
from torchrl_atr.reproduction.paper import GROUPS, PAIRS, TRANSPORTERS, group_of, other_robot
from torchrl_atr.reproduction.report import UNKNOWN, Claim, Job, judge, missing_pairs, with_interval, write_report
from torchrl_atr.reproduction.tracking import (
    EPSILONS,
    THRESHOLD,
    Grid,
    box_of,
    combined_error,
    measure,
    still_error,
    tracking_figures,
    within,
)

FAST, SLOW = 2 / 3, 1 / 3
"""Commands are fast from, and slow up to, these shares of the largest speed."""


def figure4(job: Job, folder: Path, compatibility: bool = False, grid: Grid | None = None) -> Path:
    """Measure tracking of every pair that has a policy; write figures, ``figure4.json`` and the page.

    Args:
        job: policies, seed, and finished parts.
        folder: to write to.
        compatibility: whether each policy also rides with the other robot of its group.
        grid: commands and trials; by default the job's.

    Raises:
        InputError: without a policy.
    """
    from torchrl_atr.reproduction.figures import plot_areas, plot_error_maps  # imports matplotlib

    if not job.policies:
        raise InputError("Figure 4 needs policies; give --policies RUN for each pair that you have")
    results = {policy.name: measure(job, policy, grid) for policy in job.policies}
    swapped = {}
    for policy in job.policies if compatibility else ():
        if (robot := other_robot(policy.name)) is not None:
            swapped[f"{policy.name}, ridden by {robot}"] = measure(job, policy, grid, robot=robot)
    shown = {name: [result] for name, result in results.items()}
    plot_error_maps(shown, ("speed", "yaw rate"), folder / "heatmaps.png")
    plot_areas(shown | {name: [result] for name, result in swapped.items()}, folder / "command_area.png")
    figures = {name: tracking_figures(result) for name, result in (results | swapped).items()}
    areas = {name: command_area(result, EPSILONS)["rms"] for name, result in (results | swapped).items()}
    first = next(iter(results.values()))
    text = (
        f"Root mean square errors over {first.seconds:g} s from rest, intrinsics of the test range, sensors of the "
        f"training, {first.fall_time[..., 0].size:,} commands within {box_of(first)}. Errors of trials that fell count "
        "up to the fall; such a trial is in no command area. Area: share of the trials within √(e_v² + e_ω²) ≤ "
        f"{THRESHOLD:g}. Mastered: share of the commands at which most robots settle within 0.5 m/s and 0.3 rad/s; "
        "envelope: share of those that can be followed at all. Commands are clipped where a policy has a range. The "
        "paper prints no number."
    )
    sections = [text, _table(figures), "![errors](heatmaps.png)", "![command areas](command_area.png)"]
    missing = missing_pairs(results, PAIRS)
    claims = [*_coverage(results), *_fast(results), _light(results), *_two_boards(results), *_shared(results)]
    return write_report(
        job,
        folder,
        "figure4",
        "Figure 4: command tracking over the command space",
        filter(None, [missing, *sections]),
        claims,
        pairs=figures,
        command_area={"epsilon": EPSILONS, **areas},
        missing=[pair for pair in PAIRS if pair not in results],
    )


def _table(figures: Mapping[str, dict[str, Any]]) -> str:
    head = ["pair", "trials", "up", "speed error, m/s", "yaw rate error, rad/s", "area", "still board's"]
    head += ["mastered", "envelope"]
    rows = [
        [
            name,
            f"{each['n']:,}",
            *(
                with_interval(each[key], each[f"{key}_interval"])
                for key in ("survival", "rms_speed_error", "rms_yaw_error", "area")
            ),
            with_interval(each["still_area"]),
            with_interval(each["mastered"]),
            "" if each["envelope"] is None else with_interval(each["envelope"]),
        ]
        for name, each in figures.items()
    ]
    return markdown_table(head, rows)


def _coverage(results: Mapping[str, TrackingResult]) -> Iterator[Claim]:
    for name, result in results.items():
        ours, still = within(result).ravel(), (still_error(result) <= THRESHOLD).ravel()
        value, interval = bootstrap_difference(ours.astype(float), still.astype(float), paired=True)
        yield Claim(
            "Proficient riding over a range of the command space (Sec. V-B)",
            f"{name}: command area at ε = {THRESHOLD:g} minus that of a board that never moves, above 0",
            value,
            interval,
            judge(interval),
        )


def _fast(results: Mapping[str, TrackingResult]) -> Iterator[Claim]:
    for name, result in results.items():
        error, still, high, low = combined_error(result), still_error(result), _at(result, True), _at(result, False)
        value, interval = bootstrap_difference(error[high].ravel(), error[low].ravel())
        baseline = still[high].mean() - still[low].mean()
        yield Claim(
            "Tracking drops at high speeds",
            f"{name}: combined error at |c_v| ≥ {FAST:.2f} of the largest minus that at ≤ {SLOW:.2f}, above 0",
            value,
            interval,
            judge(interval),
            f"A board that never moves: {baseline:.3f}",
        )


def _at(result: TrackingResult, fast: bool) -> Any:
    """Return a mask of the fast or the slow commands, (V,)."""
    speeds = np.abs(result.speed_commands)
    return speeds >= FAST * speeds.max() - 1e-9 if fast else speeds <= SLOW * speeds.max() + 1e-9


def _light(results: Mapping[str, TrackingResult]) -> Claim:
    text = "Robots of group 1 on the single board are worse at high speeds: too light to tilt it"
    test = "combined error at fast commands on the single board, group 1 minus group 2, above 0"
    errors: dict[str, list[Any]] = {group: [] for group in GROUPS}
    for name, result in results.items():
        group = group_of(name)
        if group is not None and name.endswith(TRANSPORTERS[0]):
            errors[group].append(combined_error(result)[_at(result, True)].ravel())
    if missing := [group for group, values in errors.items() if not values]:
        return Claim(text, test, remark=f"No policy of {' and '.join(missing)} on the single board was given")
    value, interval = bootstrap_difference(np.concatenate(errors["G1"]), np.concatenate(errors["G2"]))
    return Claim(text, test, value, interval, judge(interval))


def _two_boards(results: Mapping[str, TrackingResult]) -> Iterator[Claim]:
    text = "The two-board transporters are behind the single boards"
    robots = [robot for group in GROUPS.values() for robot in group]
    pairs = {robot: [f"{robot}-{board}" for board in TRANSPORTERS] for robot in robots}
    both = [robot for robot in robots if all(pair in results for pair in pairs[robot])]
    for robot in both:
        single, two = (combined_error(results[pair]).ravel() for pair in pairs[robot])
        value, interval = bootstrap_difference(two, single)
        test = f"{robot}: combined error on the two boards minus that on the single board, above 0"
        yield Claim(text, test, value, interval, judge(interval))
    if not both:
        yield Claim(text, "combined error, two boards minus single", remark="No robot has policies on both")


def _shared(results: Mapping[str, TrackingResult]) -> Iterator[Claim]:
    text = "Robots of a group manage the same transporter"
    found = False
    for group, robots in GROUPS.items():
        for board in TRANSPORTERS:
            pairs = [f"{robot}-{board}" for robot in robots]
            if all(pair in results for pair in pairs):
                found = True
                gains = [
                    mean_interval((within(r).astype(float) - (still_error(r) <= THRESHOLD)).ravel())
                    for r in (results[pair] for pair in pairs)
                ]
                value, interval = min(gains, key=lambda each: each[0])
                test = f"{group}, {board}: the smaller of both robots' command area beyond the still board's, above 0"
                yield Claim(text, test, value, interval, judge(interval))
    if not found:
        test = "command areas of both robots of a group on one transporter"
        yield Claim(text, test, verdict=UNKNOWN, remark="No transporter has policies of both robots of its group")

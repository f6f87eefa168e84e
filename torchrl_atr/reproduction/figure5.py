"""Figure 5: long-range navigation, riding against walking, on the same paths at the same speeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchrl_atr._cpus import available_cpus
from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic, say
from torchrl_atr._text import markdown_table
from torchrl_atr.evaluation.intervals import bootstrap_difference
from torchrl_atr.navigation import Map, PursuitConfig, TripsResult, load_map, plan_all, run_trips
from torchrl_atr.navigation import Path as Route
from torchrl_atr.navigation.film import film_best
from torchrl_atr.navigation.overview import plot_trips
from torchrl_atr.navigation.places import draw_places
from torchrl_atr.navigation.pursuit import RESPONSES
from torchrl_atr.navigation.report import load_trips, save_trips, trip_metrics
from torchrl_atr.navigation.trips import GOAL
from torchrl_atr.reproduction.policies import RiderPolicy
from torchrl_atr.reproduction.report import Claim, Job, judge, with_interval, write_report
from torchrl_atr.reproduction.trip_groups import Group, Method, group_of, method_of, speed_text

COSTS = {"paper": "mean over joints", "joints": "sum over joints", "system": "joints and drive"}
"""Costs of transport, and what they add up."""
_YAW_RATE, _MARGIN = 0.25, 0.8
"""Yaw rate of a planned turn, rad/s, and distance kept to obstacles, m."""


class Sizes(NamedTuple):
    """Maps, and the number of trips on each."""

    maps: Sequence[str] = ("open", "streets")
    starts: int = 50


QUICK = Sizes(("open",), 2)


def figure5(
    job: Job,
    folder: Path,
    walking: Sequence[RiderPolicy] = (),
    maps: Sequence[str] | None = None,
    starts: int | None = None,
) -> Path:
    """Ride, and walk, along planned paths; write figures, ``figure5.json`` and the page.

    Robots of a group follow the same paths, planned for the largest footprint among them, at the same speed: the
    paper's, or the largest that all of them take.

    Args:
        job: policies that ride, seed, and finished parts.
        folder: to write to.
        walking: policies of the walking task, to compare.
        maps: names or files of maps.
        starts: trips on each map.

    Raises:
        InputError: without a policy, for one that takes less than :data:`SLOWEST`, a wrong map, or a path that cannot
            be planned; before anything is simulated.
    """
    if not job.policies:
        raise InputError("Figure 5 needs policies that ride; give --policies RUN")
    sizes = QUICK if job.quick else Sizes()
    places = [load_map(source) for source in maps or sizes.maps]
    for option, policies, rides in (("--policies", job.policies, True), ("--walking", walking, False)):
        for policy in policies:
            if policy.rides != rides:
                other = "--policies" if policy.rides else "--walking"
                raise InputError(f"{option} {policy.folder}: it is {policy.name}; give it with {other}")
    methods = [method_of(policy) for policy in (*job.policies, *walking)]
    groups = {group: group_of(group, methods) for group in sorted({method.group for method in methods})}
    routes = {
        (where.name, name): _routes(job, where, group, starts or sizes.starts)
        for where in places
        for name, group in groups.items()
    }
    results: dict[tuple[str, str], TripsResult] = {}
    images = []
    for where in places:
        for method in methods:
            name, paths = method.policy.name, routes[where.name, method.group]
            speed = groups[method.group].speed
            result = results[where.name, name] = _trips(job, method, where, paths, speed)
            images.append(plot_trips(result, paths, where, folder / f"{where.name}-{name}.png"))
        images.append(_film(results, routes, methods, where, folder))
    rows = [{"map": where, "method": name, **trip_metrics(result)} for (where, name), result in results.items()]
    _plot(results, folder / "cost_of_transport.png")
    differences = list(_differences(results, methods))
    speeds = " and ".join(speed_text(group) for group in groups.values())
    text = (
        "Paths by RRT* over Dubins curves and a spline; pure pursuit, of riders from where they will be in 2 s; "
        f"the robots' places known; {speeds}, from rest, sensors of the training. A trip ends at the goal, in a fall, "
        "in a collision, or after twice the path's time. Costs of transport are of trips that reached the goal: power "
        "over m g v with the robot's mass, of torque and velocity of the same instant. A method that falls spends "
        "nothing: read them beside the successes. The paper prints no numbers here."
    )
    sections = [text, _table(rows), "![cost of transport](cost_of_transport.png)"]
    if not walking:
        sections.insert(1, "No walking policy was given: there is nothing to compare with.")
    sections += [f"![trips, {image.stem}]({image.name})" for image in images]
    claims = [_claim(each) for each in differences] or [_claim(None)]
    return write_report(
        job,
        folder,
        "figure5",
        "Figure 5: long-range navigation",
        sections,
        claims,
        trips=rows,
        differences=differences,
        walking={policy.name: policy.described() for policy in walking},
    )


def _routes(job: Job, where: Map, group: Group, starts: int) -> list[Route]:
    speed, footprint = group.speed, group.footprint
    asked = {"map": where.free.wkt, "speed": speed, "footprint": footprint, "starts": starts, "seed": job.seed}

    def make(part: Path) -> None:
        begins, goal = draw_places(where, starts, footprint, _MARGIN, seed=job.seed)
        say(f"planning {starts} paths on {where.name!r} for {group.name}")
        radius = speed / _YAW_RATE
        paths = plan_all(
            begins,
            available_cpus(),
            job.seed + 1,
            where=where,
            goal=goal,
            turning_radius=radius,
            footprint=footprint,
            margin=_MARGIN,
        )
        arrays = {f"{field}_{i}": value for i, path in enumerate(paths) for field, value in vars(path).items()}
        with atomic(part / "paths.npz") as file:
            np.savez_compressed(file, **arrays)

    with np.load(job.parts.get(f"paths-{where.name}-{group.name}", asked, make) / "paths.npz") as file:
        return [Route(file[f"points_{i}"], file[f"curvature_{i}"]) for i in range(starts)]


def _trips(job: Job, method: Method, where: Map, paths: Sequence[Route], speed: float) -> TripsResult:
    policy, length = method.policy, [round(path.length, 6) for path in paths]
    response = RESPONSES.get(policy.config.task.name, 0.0)
    pursuit = PursuitConfig(
        speed=speed, max_yaw_rate=min(PursuitConfig.max_yaw_rate, method.turning), response=response
    )
    asked = {"policy": policy.fingerprint, "map": where.free.wkt, "paths": length, "seed": job.seed}
    asked |= {"pursuit": asdict(pursuit)}

    def make(part: Path) -> None:
        with job.progress(f"{policy.name} on {where.name}") as progress:
            result = run_trips(policy.policy, policy.envs(), paths, where, pursuit, seed=job.seed, progress=progress)
        save_trips(result, paths, part / "trips.npz")

    return load_trips(job.parts.get(f"trips-{where.name}-{policy.name}", asked, make) / "trips.npz")


def _film(
    results: Mapping[tuple[str, str], TripsResult],
    routes: Mapping[tuple[str, str], Sequence[Route]],
    methods: Sequence[Method],
    where: Map,
    folder: Path,
) -> Path:
    """Film one trip on a map, of the policy that most often arrives there."""
    method = max(methods, key=lambda each: (results[where.name, each.policy.name].outcome == GOAL).sum())
    name = method.policy.name
    file = folder / f"{where.name}-{name}.gif"
    return film_best(results[where.name, name], routes[where.name, method.group], where, file)


def _differences(results: Mapping[tuple[str, str], TripsResult], methods: Sequence[Method]) -> Iterator[dict[str, Any]]:
    """Yield, for each map and pair with a walking policy, walking minus riding on the paths that both completed."""
    walkers = {method.robot: method.policy.name for method in methods if not method.policy.rides}
    for (where, name), riding in results.items():
        robot = next(method.robot for method in methods if method.policy.name == name)
        if walkers.get(robot) in (None, name):
            continue
        walking = results[where, walkers[robot]]
        both = (riding.outcome == GOAL) & (walking.outcome == GOAL)
        row: dict[str, Any] = {"map": where, "riding": name, "walking": walkers[robot], "paths": int(both.sum())}
        for cost in COSTS:
            pair = [np.asarray(getattr(each.cost, cost), dtype=float)[both] for each in (walking, riding)]
            value, interval = bootstrap_difference(pair[0], pair[1], paired=True)
            row[cost] = {"difference": value if both.any() else None, "interval": interval and list(interval)}
        yield row


def _claim(row: Mapping[str, Any] | None) -> Claim:
    text = "Transporters reduce the power consumption of robots, for all pairs"
    if row is None:
        test = "the paper's cost of transport, walking minus riding on the same paths, above 0"
        return Claim(text, test, remark="No walking policy of a riding robot was given")
    test = f"{row['map']}, {row['walking']} minus {row['riding']}: the paper's cost of transport on the paths that both"
    value, interval = row["paper"]["difference"], row["paper"]["interval"]
    remark = f"{row['paths']} paths; {', '.join(_cost(row, cost) for cost in COSTS if cost != 'paper')}"
    return Claim(text, f"{test} completed, above 0", value, interval, judge(interval), remark)


def _cost(row: Mapping[str, Any], cost: str) -> str:
    return f"{COSTS[cost]}: {with_interval(row[cost]['difference'], row[cost]['interval'])}"


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    names = ("spl", "seconds", "deviation", *(f"cot_{cost}" for cost in COSTS))
    head = ["map", "policy", "trips", "at the goal", "SPL", "time, s", "off the path, m"]
    head += [f"CoT, {text}" for text in COSTS.values()]
    body = [
        [
            row["map"],
            row["method"],
            str(row["trips"]),
            with_interval(row["success"], row["success_interval"], 2),
            *(with_interval(row[name]["mean"], row[name]["interval"]) for name in names),
        ]
        for row in rows
    ]
    return markdown_table(head, body)


def _plot(results: Mapping[tuple[str, str], TripsResult], path: Path) -> Path:
    from matplotlib import rc_context

    from torchrl_atr.evaluation.plotting import STYLE, save, subplots

    maps = list(dict.fromkeys(where for where, _ in results))
    names = list(dict.fromkeys(name for _, name in results))
    with rc_context(STYLE):
        figure, axes = subplots(1, len(maps), figsize=(1.5 + 3.6 * len(maps), 3.4), sharey=True, squeeze=False)
        for axis, where in zip(axes[0], maps):
            for place, name in enumerate(names):
                result = results[where, name]
                values = np.asarray(result.cost.joints, dtype=float)[result.outcome == GOAL]
                if len(values):
                    axis.boxplot(values, positions=[place], widths=0.6)
                else:
                    axis.text(
                        place,
                        0.5,
                        "none at the goal",
                        rotation=90,
                        ha="center",
                        va="center",
                        transform=axis.get_xaxis_transform(),
                        fontsize=8,
                    )
            axis.set_xticks(range(len(names)), names, rotation=40, ha="right")
            axis.set(title=where, xlim=(-0.6, len(names) - 0.4), ylim=(0.0, None))
            axis.grid(alpha=0.25, axis="y")
        axes[0, 0].set_ylabel("cost of transport, sum over joints")
        return save(figure, path)

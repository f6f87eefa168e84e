"""Paths of bounded curvature between two places: RRT* over Dubins curves (OMPL), smoothed by a spline."""

from __future__ import annotations

import itertools
import math
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d
from shapely.geometry.base import BaseGeometry

from torchrl_atr._checks import check_number
from torchrl_atr._errors import InputError
from torchrl_atr.navigation.map import Map, MapError

Array = NDArray[np.float64]
Place = tuple[float, float]
STEP = 0.1
"""Distance of two points of a path, m."""
WIDER = 1.25
"""Factor of the turning radius in planning: smoothing and the spline exceed a Dubins curve's curvature a little."""
SMOOTHING = 0.25
"""Standard deviation of the Gaussian that smooths a Dubins curve, in turning radii."""
SPACING = 0.5
"""Distance of the spline's control points, m."""
HEADINGS = tuple(np.linspace(-math.pi, math.pi, 8, endpoint=False).tolist())
"""Directions of travel at the ends that the planner chooses from, rad."""
ROUNDS = 10
"""Largest number of times that the planner's iterations are repeated until there is a path."""
CELL = 0.25
"""Size of the cells of the planner's raster, m; the spline is checked against the polygons themselves."""


class PathError(InputError):
    """Error of a path that cannot be planned; the message names the cause and the remedy."""


@dataclass(frozen=True)
class Path:
    """Points of a path, :data:`STEP` apart.

    Attributes:
        points: x and y, m, (P, 2).
        curvature: signed, positive to the left, 1/m, (P,).

    Example:
        >>> straight = Path.through(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]))
        >>> round(straight.length, 6), round(float(abs(straight.curvature).max()), 6)
        (3.0, 0.0)
    """

    points: Array
    curvature: Array

    @property
    def length(self) -> float:
        """Length, m."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=-1).sum())

    @property
    def headings(self) -> Array:
        """Direction of travel, rad, (P,)."""
        ahead = np.gradient(self.points, axis=0)
        return np.arctan2(ahead[:, 1], ahead[:, 0])

    @classmethod
    def through(cls, control: Array) -> Path:
        """Return the cubic spline through control points, (K, 2), K >= 4, with points at equal distances."""
        along = np.concatenate([[0.0], np.linalg.norm(np.diff(control, axis=0), axis=-1).cumsum()])
        spline = make_interp_spline(along, control, k=3)
        fine = np.linspace(0.0, along[-1], max(2, 10 * math.ceil(along[-1] / STEP)))
        travelled = np.concatenate([[0.0], np.linalg.norm(np.diff(spline(fine), axis=0), axis=-1).cumsum()])
        at = np.interp(np.linspace(0.0, travelled[-1], math.ceil(travelled[-1] / STEP) + 1), travelled, fine)
        (dx, dy), (ddx, ddy) = spline(at, 1).T, spline(at, 2).T
        return cls(spline(at), (dx * ddy - dy * ddx) / np.maximum(np.hypot(dx, dy), 1e-9) ** 3)


def swept(path: Path, footprint: tuple[float, float]) -> BaseGeometry:
    """Return the area that a rectangle of ``footprint`` (length, width) covers on its way along a path, m."""
    return shapely.union_all(rectangles(path.points, path.headings, footprint))


def rectangles(places: Array, headings: Array, footprint: tuple[float, float]) -> Any:
    """Return rectangles of length and width ``footprint`` at places (n, 2) in directions (n,), as polygons, (n,)."""
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * np.asarray(footprint) / 2
    cosine, sine = np.cos(headings)[:, None], np.sin(headings)[:, None]
    x = cosine * corners[:, 0] - sine * corners[:, 1]
    y = sine * corners[:, 0] + cosine * corners[:, 1]
    return shapely.polygons(np.stack([x, y], -1) + places[:, None])


def plan(
    where: Map,
    start: Place,
    goal: Place,
    turning_radius: float,
    footprint: tuple[float, float],
    *,
    margin: float = 0.5,
    iterations: int = 1000,
    seed: int = 1,
) -> Path:
    """Plan a path: RRT* in Dubins space, then a spline whose curvature and swept footprint are checked.

    Args:
        where: obstacles.
        start: x and y, m; the path begins and ends in whichever direction suits it.
        goal: likewise.
        turning_radius: smallest, m.
        footprint: length and width of what moves, m.
        margin: distance to obstacles that is kept besides, m, so that tracking errors do not end in a collision.
        iterations: of RRT*, up to :data:`ROUNDS` times as many until there is a path; more find shorter paths.
        seed: of the planner, at least 1. OMPL takes one seed in a process: use :func:`plan_all` to repeat paths.

    Raises:
        MapError: for a start or goal that is too close to an obstacle.
        PathError: if no path was found.

    Example:
        >>> import shapely
        >>> yard = Map("yard", shapely.box(0, 0, 30, 20), (shapely.box(14, 0, 16, 12),))
        >>> path = plan(yard, (5.0, 5.0), (25.0, 5.0), 2.0, (0.8, 0.4), iterations=500)
        >>> bool(abs(path.curvature).max() <= 0.5), yard.free.contains(swept(path, (0.8, 0.4)))
        (True, True)
    """
    check_number("turning_radius", turning_radius, above=0.0)
    room = where.shrunk(math.hypot(*footprint) / 2 + check_number("margin", margin, 0.0))
    for name, place in (("start", start), ("goal", goal)):
        _check_place(where, room, name, place)
    coarse = _search(room, start, goal, WIDER * turning_radius, iterations, seed)
    problem = f"map {where.name!r}: no path from {_text(start)} to {_text(goal)}"
    remedy = "choose another goal, a smaller turning radius (a slower speed) or margin, or more iterations"
    if coarse is None:
        raise PathError(f"{problem} with turns of {turning_radius:g} m and {margin:g} m of margin; {remedy}")
    path = Path.through(_resampled(_smoothed(coarse, SMOOTHING * turning_radius), SPACING))
    if np.abs(path.curvature).max() > 1.0 / turning_radius or not where.free.contains(swept(path, footprint)):
        raise PathError(f"{problem} that a smooth curve with turns of {turning_radius:g} m can follow; {remedy}")
    return path


def plan_all(starts: Sequence[Place], workers: int, seed: int, **arguments: Any) -> list[Path]:
    """Plan a path from each start, each in a process of its own: the same seed gives the same paths.

    Args:
        starts: x and y, m.
        workers: processes at a time.
        seed: of the first path; the others have the seeds after it.
        **arguments: of :func:`plan`.

    Raises:
        MapError, PathError: of the first path that cannot be planned.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, max_tasks_per_child=1) as pool:
        tasks = [pool.submit(plan, start=start, seed=seed + i, **arguments) for i, start in enumerate(starts)]
        try:
            return [task.result() for task in tasks]
        except BaseException:  # the other paths are not needed
            for task in tasks:
                task.cancel()
            raise


def _check_place(where: Map, room: BaseGeometry, name: str, place: Place) -> None:
    if not shapely.contains_xy(room, *place):
        inside = "is in an obstacle or outside" if not where.holds(place) else "is too close to an obstacle or the edge"
        raise MapError(f"map {where.name!r}: the {name} {_text(place)} {inside}; choose a place in free space")


def _text(place: Place) -> str:
    return f"({place[0]:g}, {place[1]:g})"


def _search(room: BaseGeometry, start: Place, goal: Place, radius: float, iterations: int, seed: int) -> Array | None:
    """Return the points of the best Dubins path from RRT*, (P, 2), or None."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed)
    space, free = base.DubinsStateSpace(radius), _raster(room)
    low_x, low_y, high_x, high_y = room.bounds
    bounds = base.RealVectorBounds(2)
    for axis, low, high in ((0, low_x, high_x), (1, low_y, high_y)):
        bounds.setLow(axis, low)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)

    def is_valid(state: Any) -> bool:
        row, column = int((state.getY() - low_y) / CELL), int((state.getX() - low_x) / CELL)
        return 0 <= row < len(free) and 0 <= column < len(free[0]) and free[row][column]

    def at(place: Place, heading: float) -> Any:
        state = space.allocState()
        state.setXY(*place)
        state.setYaw(heading)
        return state

    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(is_valid)
    setup.getSpaceInformation().setStateValidityCheckingResolution(CELL / space.getMaximumExtent())
    ends = base.GoalStates(setup.getSpaceInformation())
    for heading in HEADINGS:
        setup.addStartState(at(start, heading))
        ends.addState(at(goal, heading))
    setup.setGoal(ends)
    planner = geometric.RRTstar(setup.getSpaceInformation())
    setup.setPlanner(planner)
    for _ in range(ROUNDS):
        counted = itertools.count()
        stop = base.PlannerTerminationCondition(lambda counted=counted: next(counted) >= iterations)
        setup.solve(stop)  # it continues with the tree that it has
        if setup.haveExactSolutionPath():
            path = setup.getSolutionPath()
            path.interpolate(max(8, math.ceil(path.length() / STEP)))
            return np.array([(state.getX(), state.getY()) for state in path.getStates()])
    return None


def _raster(room: BaseGeometry) -> list[list[bool]]:
    """Return whether the centres of cells are free, by row and column from the lower left corner of the bounds."""
    low_x, low_y, high_x, high_y = room.bounds
    x, y = np.arange(low_x + CELL / 2, high_x, CELL), np.arange(low_y + CELL / 2, high_y, CELL)
    free: list[list[bool]] = shapely.contains_xy(room, *np.meshgrid(x, y)).tolist()
    return free


def _smoothed(points: Array, std: float) -> Array:
    """Return a polyline of equal steps :data:`STEP` smoothed by a Gaussian, its ends fixed, (P, 2)."""
    points = _resampled(points, STEP)
    n = min(len(points) - 1, math.ceil(4 * std / STEP))
    before, after = 2 * points[0] - points[n:0:-1], 2 * points[-1] - points[-2 : -n - 2 : -1]
    return gaussian_filter1d(np.concatenate([before, points, after]), std / STEP, axis=0)[n:-n]


def _resampled(points: Array, spacing: float) -> Array:
    """Return points of a polyline about ``spacing`` apart, at least four, (K, 2)."""
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=-1).cumsum()])
    at = np.linspace(0.0, along[-1], max(4, math.ceil(along[-1] / spacing) + 1))
    return np.stack([np.interp(at, along, points[:, axis]) for axis in range(2)], -1)

"""Random places on a map."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely

from torchrl_atr.navigation.map import Map, MapError

Place = tuple[float, float]
APART = 0.5
"""Least distance of start and goal, as a share of the map's diagonal: trips are long."""
TRIES = 10_000


def draw_places(
    where: Map,
    count: int,
    footprint: tuple[float, float],
    margin: float,
    goal: Sequence[float] | None = None,
    seed: int = 0,
) -> tuple[list[Place], Place]:
    """Draw start positions, and a goal if none is given, uniform in free space and far apart.

    Args:
        where: map.
        count: of the starts.
        footprint: length and width of what moves, m.
        margin: distance to obstacles besides, m.
        goal: given place, m; it is checked when paths are planned.
        seed: of the places.

    Raises:
        MapError: if the map has too little space.

    Example:
        >>> yard = Map("yard", shapely.box(0, 0, 50, 50))
        >>> starts, goal = draw_places(yard, 3, (0.8, 0.4), 1.0)
        >>> len(starts), all(math.dist(start, goal) > 35 for start in starts)
        (3, True)
    """
    room = where.shrunk(math.hypot(*footprint) / 2 + margin)
    low_x, low_y, high_x, high_y = where.outline.bounds
    least = APART * math.hypot(high_x - low_x, high_y - low_y)
    points = np.random.default_rng(seed).uniform((low_x, low_y), (high_x, high_y), (TRIES, 2))
    places = [(float(x), float(y)) for x, y in points[shapely.contains_xy(room, points)]]
    goals = [(float(goal[0]), float(goal[1]))] if goal is not None else places[:50]
    for end in goals:
        starts = [place for place in places if math.dist(place, end) >= least][:count]
        if len(starts) == count:
            return starts, end
    raise MapError(
        f"map {where.name!r}: {count} starts at least {least:.0f} m from a goal do not fit with {margin:g} m of "
        "margin; choose fewer, another goal or a smaller margin"
    )

"""Planned paths keep their curvature, their distance to obstacles, and their ends."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import shapely

from torchrl_atr.navigation import Map, MapError, Path, PathError, paths, plan, plan_all
from torchrl_atr.navigation.paths import STEP, rectangles, swept
from torchrl_atr.navigation.places import draw_places

YARD = Map("yard", shapely.box(0, 0, 30, 20), (shapely.box(14, 0, 16, 12),))
BOARD = (0.8, 0.4)


def test_a_circle_has_the_curvature_of_its_radius_and_the_spline_equal_steps():
    angle = np.linspace(0.0, np.pi, 40)
    path = Path.through(5.0 * np.stack([np.cos(angle), np.sin(angle)], -1))
    assert path.length == pytest.approx(5.0 * np.pi, rel=1e-3)
    np.testing.assert_allclose(path.curvature[10:-10], 0.2, rtol=0.01)  # to the left
    np.testing.assert_allclose(np.linalg.norm(np.diff(path.points, axis=0), axis=-1), STEP, rtol=0.01)


def test_a_rectangle_turns_with_its_heading_and_sweeps_its_width():
    (turned,) = rectangles(np.array([[1.0, 2.0]]), np.array([np.pi / 2]), BOARD)
    np.testing.assert_allclose(turned.bounds, (0.8, 1.6, 1.2, 2.4))
    straight = Path.through(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]))
    assert swept(straight, BOARD).area == pytest.approx((3.0 + 0.8) * 0.4)


@pytest.mark.parametrize("radius", [1.5, 3.0])
def test_a_path_goes_round_a_wall_within_its_curvature(radius):
    path = plan(YARD, (5.0, 5.0), (25.0, 5.0), radius, BOARD, iterations=300)
    np.testing.assert_allclose(path.points[[0, -1]], [(5.0, 5.0), (25.0, 5.0)], atol=0.3)
    assert np.abs(path.curvature).max() <= 1.0 / radius
    assert YARD.free.contains(swept(path, BOARD))
    assert path.points[:, 1].max() > 12.0
    assert 2 * np.hypot(9.0, 7.0) < path.length < 40.0


def test_the_same_seed_gives_the_same_paths():
    asked = {"where": YARD, "goal": (25.0, 5.0), "turning_radius": 2.0, "footprint": BOARD, "iterations": 100}
    first, second = (plan_all([(5.0, 5.0), (5.0, 15.0)], 2, 3, **asked) for _ in range(2))
    for one, other in zip(first, second):
        np.testing.assert_array_equal(one.points, other.points)


@pytest.mark.parametrize(
    ("start", "goal", "radius", "message"),
    [
        ((15.0, 5.0), (25.0, 5.0), 2.0, r"the start \(15, 5\) is in an obstacle or outside"),
        ((5.0, 5.0), (40.0, 5.0), 2.0, r"the goal \(40, 5\) is in an obstacle or outside"),
        ((5.0, 5.0), (29.5, 5.0), 2.0, r"the goal \(29.5, 5\) is too close to an obstacle or the edge"),
    ],
)
def test_a_place_that_cannot_be_is_named_before_planning(start, goal, radius, message):
    with pytest.raises(MapError, match=message):
        plan(YARD, start, goal, radius, BOARD)


def test_an_unreachable_goal_says_what_to_change():
    walled = Map("walled", shapely.box(0, 0, 30, 20), (shapely.box(14, 0, 16, 20),))
    with pytest.raises(PathError, match=r"no path from \(5, 5\) to \(25, 5\) .* choose another goal"):
        plan(walled, (5.0, 5.0), (25.0, 5.0), 2.0, BOARD, iterations=30)


def searched(monkeypatch, points):
    """Let the planner find these points."""
    monkeypatch.setattr(paths, "_search", lambda *_: points)
    return partial(plan, start=tuple(points[0]), goal=tuple(points[-1]), footprint=BOARD)


def test_a_curve_that_is_too_tight_is_no_path(monkeypatch):
    """A half circle of 2 m is refused for turns of 3 m, and does for those of 1.5 m."""
    angle = np.linspace(0.0, np.pi, 100)
    find = searched(monkeypatch, 8.0 + 2.0 * np.stack([np.cos(angle), np.sin(angle)], -1))
    assert np.abs(find(YARD, turning_radius=1.5).curvature).max() > 1.0 / 3.0
    with pytest.raises(PathError, match=r"no path .* that a smooth curve with turns of 3 m can follow"):
        find(YARD, turning_radius=3.0)


def test_a_curve_through_an_obstacle_is_no_path(monkeypatch):
    find = searched(monkeypatch, np.linspace([5.0, 5.0], [25.0, 5.0], 100))
    assert find(Map("empty", YARD.outline), turning_radius=2.0).length == pytest.approx(20.0)
    with pytest.raises(PathError, match=r"no path .* that a smooth curve with turns of 2 m can follow"):
        find(YARD, turning_radius=2.0)


def test_drawn_places_are_free_far_apart_and_repeatable():
    starts, goal = draw_places(YARD, 20, BOARD, 0.5, seed=4)
    assert (starts, goal) == draw_places(YARD, 20, BOARD, 0.5, seed=4)
    assert YARD.holds(starts).all()
    assert np.linalg.norm(np.array(starts) - goal, axis=-1).min() > np.hypot(30, 20) / 2
    with pytest.raises(MapError, match="5 starts at least 18 m from a goal do not fit"):
        draw_places(YARD, 5, BOARD, 9.9)

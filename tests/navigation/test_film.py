"""Moving overview of a trip: frames in closed form, files, bad input."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import shapely
from PIL import Image

from torchrl_atr._errors import InputError
from torchrl_atr.evaluation.energy import CostOfTransport
from torchrl_atr.navigation import Map, Path, TripsResult
from torchrl_atr.navigation import film as module
from torchrl_atr.navigation.film import best_trip, film_trip

FIELD = Map("field", shapely.box(-10, -10, 110, 10))
STRAIGHT = Path.through(np.linspace([0.0, 0.0], [100.0, 0.0], 4))


def straight_trip(steps=500, speed=2.0):
    """Return a trip along x at a constant speed, whose joints need 10 W and whose drive needs 5 W a second more."""
    seconds = 0.2 * np.arange(steps + 1)
    zero = np.zeros_like(seconds)
    trace = np.stack([speed * seconds, zero, zero, seconds, zero + 10.0, 5.0 * (seconds - 0.1)], -1)
    trace[0, 4:] = 0.0
    one = np.ones(1)
    return TripsResult(np.array(["goal"]), *[one] * 7, CostOfTransport(one, one, one), [trace])


def test_frames_hold_means_since_the_frame_before():
    frames = module._frames(straight_trip().traces[0])
    assert len(frames.seconds) == module.FRAMES
    np.testing.assert_allclose(frames.seconds[[0, -1]], [0.0, 100.0])
    np.testing.assert_allclose(frames.speed[1:], 2.0)
    np.testing.assert_allclose(frames.power[1:, 0], 10.0)
    between = (frames.seconds[1:] + frames.seconds[:-1]) / 2
    np.testing.assert_allclose(frames.power[1:, 1], 5.0 * between)


def test_a_trip_becomes_a_small_moving_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "FRAMES", 4)
    file = film_trip(straight_trip(), STRAIGHT, FIELD, 0, tmp_path / "trip.gif")
    with Image.open(file) as picture:
        assert picture.n_frames == 4
    assert file.stat().st_size < module.FRAMES * 10_000


def test_a_robot_that_never_moved_is_filmed_too(tmp_path):
    result = straight_trip(steps=0)
    result.outcome[:] = "fell"
    with Image.open(film_trip(result, STRAIGHT, FIELD, 0, tmp_path / "trip.gif")) as picture:
        assert picture.n_frames == 1


def test_the_longest_trip_that_arrived_is_shown():
    ones = {field.name: np.ones(3) for field in dataclasses.fields(TripsResult)}
    lengths = {"planned": np.array([5.0, 9.0, 7.0]), "travelled": np.array([5.0, 1.0, 2.0])}
    result = TripsResult(**ones | lengths | {"outcome": np.array(["goal", "fell", "goal"])})
    assert best_trip(result) == 2
    lost = dataclasses.replace(result, outcome=np.array(["fell"] * 3))
    assert best_trip(lost) == 0


@pytest.mark.parametrize(
    ("trip", "file", "text"), [(0, "trip.mp4", "not a .gif"), (1, "trip.gif", "trip=1 is not there")]
)
def test_bad_input_is_named(tmp_path, trip, file, text):
    with pytest.raises(InputError, match=text):
        film_trip(straight_trip(), STRAIGHT, FIELD, trip, tmp_path / file)

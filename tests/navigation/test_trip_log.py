"""The record of trips by hand: robots that are where they are said to be, without a simulation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import shapely
import torch

from torchrl_atr.evaluation.energy import Power
from torchrl_atr.navigation import Map, Path, PurePursuit, PursuitConfig, trips

FIELD = Map("field", shapely.box(-50, -50, 50, 50))
CONFIG = PursuitConfig(speed=1.5)
EAST = Path.through(np.linspace([0.0, 0.0], [20.0, 0.0], 4))
NORTH = Path.through(np.linspace([3.0, 4.0], [3.0, 24.0], 4))


@pytest.fixture
def travel(monkeypatch):
    """Takes a robot along a path through poses (T, 3) of its own plane; returns the log and the pinned commands."""
    at, pinned = [], []
    env = SimpleNamespace(action_spec=torch.zeros(1, 12))
    monkeypatch.setattr(trips, "poses_of", lambda _: at[-1])
    monkeypatch.setattr(trips, "command_owner", lambda _: SimpleNamespace(pin=pinned.append))
    monkeypatch.setattr(trips, "footprint_of", lambda _: (0.8, 0.4))
    monkeypatch.setattr(trips, "measure_power", lambda _: Power(torch.ones(1, 12), torch.ones(1)))
    monkeypatch.setattr(trips, "robot_mass", lambda _: torch.ones(1))

    def run(path, poses):
        log = trips._TripLog(env, [path], FIELD, CONFIG, None)
        for index, pose in enumerate(poses):
            at.append(np.array([pose]))
            log(SimpleNamespace(index=index, down=torch.zeros(1, dtype=torch.bool)))
        return log, torch.cat(pinned).numpy()

    return run


def test_a_robot_whose_path_goes_north_goes_north(travel):
    """Its own plane has x along the path: 2 m ahead and 0.5 m to the left are 2 m north and 0.5 m west."""
    log, _ = travel(NORTH, [(2.0, 0.5, 0.1)])
    np.testing.assert_allclose(log.poses, [[2.5, 6.0, np.pi / 2 + 0.1]], atol=1e-9)


@pytest.mark.parametrize(("beside", "mean", "largest"), [([0.5, 0.5, 0.5], 0.5, 0.5), ([0.1, -0.6, 0.2], 0.3, 0.6)])
def test_deviations_are_distances_to_the_path(travel, beside, mean, largest):
    log, _ = travel(EAST, [(1.0, y, 0.0) for y in beside])
    result = log.result()
    assert result.deviation == pytest.approx([mean])
    assert result.largest_deviation == pytest.approx([largest])


def test_what_is_pinned_is_the_pursuits_speed_and_yaw_rate(travel):
    poses = [(1.0, 0.0, 0.0), (1.1, 0.3, 0.2)]
    _, pinned = travel(EAST, poses)
    pursuit = PurePursuit([EAST], CONFIG)
    np.testing.assert_allclose(pinned[0], [CONFIG.speed, 0.0], atol=1e-6)  # straight ahead
    np.testing.assert_allclose(pinned, [pursuit.command(np.array([pose]))[0] for pose in poses], atol=1e-6)
    assert pinned[1, 1] < 0.0  # back to the path, to the right

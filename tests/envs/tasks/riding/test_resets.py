"""Early termination: each limit from both sides (A34)."""

from __future__ import annotations

import math

import pytest

from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS, build_scene
from torchrl_atr.envs.profiles import get_readings
from torchrl_atr.envs.task.terminations import fallen


@pytest.fixture(scope="module")
def scene():
    return build_scene(ROBOTS.get("a1"), TRANSPORTERS.get("single_board_g1"))


@pytest.mark.parametrize(
    ("situation", "ends"),
    [
        ({}, False),
        ({"euler": [0.99, 0.0, 0.0]}, False),
        ({"euler": [1.01, 0.0, 0.0]}, True),
        ({"euler": [0.0, -1.01, 0.0]}, True),
        ({"euler": [0.0, 0.0, 3.0]}, False),
        ({"position": [0.44, 0.0, 0.455]}, False),
        ({"position": [0.46, 0.0, 0.455]}, True),
        ({"position": [0.0, -0.34, 0.455]}, False),
        ({"position": [0.0, -0.36, 0.455]}, True),
        # the deck's length lies along y after a quarter turn
        ({"position": [0.0, 0.40, 0.455], "platform_euler": [0.0, 0.0, math.pi / 2]}, False),
        ({"position": [0.40, 0.0, 0.455], "platform_euler": [0.0, 0.0, math.pi / 2]}, True),
        ({"position": [5.2, 0.0, 0.455], "platform_position": [5.0, 0.0, 0.15]}, False),
        ({"position": [0.0, 0.0, 0.15 + 0.025 + 0.15]}, False),
        ({"position": [0.0, 0.0, 0.15 + 0.025 + 0.13]}, True),
        ({"position": [0.0, math.nan, 0.455]}, True),
        ({"joint_velocity": [math.inf] + [0.0] * 11}, True),
    ],
)
def test_limits(make_state, scene, situation, ends):
    assert fallen(make_state(**situation), scene, get_readings()).tolist() == [ends]


def test_the_tilt_limit_is_a_reading(make_state, scene):
    state = make_state(euler=[0.0, 0.9, 0.0])
    assert not fallen(state, scene, get_readings()).item()
    assert fallen(state, scene, get_readings("ancestor")).item()

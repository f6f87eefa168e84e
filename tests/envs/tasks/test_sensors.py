"""Sensor sets: what robots have, and what a set of one's own may name."""

from __future__ import annotations

import math

import pytest
import torch

from torchrl_atr._registry import UnknownNameError
from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.tasks import ObservationError, riding, walking
from torchrl_atr.envs.tasks.proprioception import PROPRIO
from torchrl_atr.envs.tasks.sensors import with_sensors

N = 500


def test_ideal_sensors_are_exact():
    assert not any(term.has_errors for term in with_sensors(PROPRIO, "ideal").values())


@pytest.mark.parametrize("task", [riding, walking])
def test_realistic_sensors_err_by_their_figures(task):
    env = QuadrupedEnv(task(sensors="realistic", pushes=False), N, seed=0, num_threads=1)
    td = env.reset()
    exact = env.runner.observe(td["command"])["proprio"]
    exact[:, :3] = 0.0  # accelerations are zero at a reset
    error = (td["proprio"] - exact)[:, :44]
    imu = [math.hypot(0.1, 0.05)] * 3 + [math.hypot(0.02, 0.01)] * 3 + [math.radians(0.5)] * 2
    expected = torch.tensor(imu + [0.005] * 12 + [0.1] * 12)
    torch.testing.assert_close(error[:, :32].std(0), expected, rtol=0.15, atol=0.0)
    assert not error[:, 32:].any()  # the last action is known


def test_a_set_of_ones_own_replaces_what_it_names():
    group = with_sensors(PROPRIO, {"joint_position": {"noise": 0.02}})
    assert group["joint_position"].noise == 0.02
    assert group["joint_velocity"] == PROPRIO["joint_velocity"]


def test_what_no_set_can_name_is_named():
    with pytest.raises(UnknownNameError, match="realistic"):
        with_sensors(PROPRIO, "realstic")
    with pytest.raises(ObservationError, match="the sensor set names 'nose'"):
        with_sensors(PROPRIO, {"nose": {"noise": 1.0}})
    with pytest.raises(ObservationError, match="noise=-1"):
        with_sensors(PROPRIO, {"acceleration": {"noise": -1.0}})

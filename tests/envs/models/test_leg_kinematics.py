"""Kinematics of the legs against MuJoCo's."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from torchrl_atr.envs.models import ROBOTS
from torchrl_atr.envs.models.feet import find_feet
from torchrl_atr.envs.models.leg_kinematics import LegKinematics
from torchrl_atr.envs.models.loading import load_robot_model


@pytest.mark.parametrize("name", ["a1", "go1", "anymal_c", "spot"])
def test_feet_are_where_mujoco_has_them(name):
    robot = ROBOTS.get(name)
    angles = torch.tensor(robot.q0) + 0.4 * torch.randn(3, 12, generator=torch.Generator().manual_seed(0))
    found = LegKinematics(robot)(angles)
    _, model = load_robot_model(robot)
    data, root = mujoco.MjData(model), int(model.joint(int(model.body(robot.trunk).jntadr[0])).qposadr[0])
    data.qpos[root : root + 7] = [0, 0, 0, 1, 0, 0, 0]
    for row, expected in zip(angles, found):
        data.qpos[[int(model.joint(joint).qposadr[0]) for joint in robot.joints]] = row.numpy()
        mujoco.mj_kinematics(model, data)
        feet = np.stack([data.geom_xpos[list(foot)].mean(0) for foot in find_feet(model, robot)])
        np.testing.assert_allclose(expected, feet, atol=1e-6)

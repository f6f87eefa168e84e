"""Kinematics of the legs against MuJoCo's."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from torchrl_atr._errors import InputError
from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.models import ROBOTS, RobotError
from torchrl_atr.envs.models.feet import find_feet
from torchrl_atr.envs.models.leg_kinematics import LegKinematics, with_stance
from torchrl_atr.envs.models.loading import load_robot_model
from torchrl_atr.envs.tasks import make_task, riding


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


@pytest.mark.parametrize("name", ["a1", "spot"])
def test_a_stance_moves_the_feet_apart_and_the_trunk_down(name):
    robot = ROBOTS.get(name)
    legs, stands = LegKinematics(robot), with_stance(robot, wider=0.15, longer=0.1, lower=0.1)
    moved = (legs(torch.tensor(stands.q0)) - legs(torch.tensor(robot.q0))) / robot.standing_height
    expected = [[0.1, -0.15, 0.1], [-0.1, -0.15, 0.1], [0.1, 0.15, 0.1], [-0.1, 0.15, 0.1]]  # FR, RR, FL, RL
    torch.testing.assert_close(moved, torch.tensor(expected), atol=2e-3, rtol=0)
    assert stands.standing_height == pytest.approx(0.9 * robot.standing_height)
    assert with_stance(robot, 0.0, 0.0, 0.0) is robot


def test_a_stance_beyond_the_legs_is_named():
    with pytest.raises(RobotError, match=r"robot 'a1': its legs do not reach a stance 0.5 wider"):
        with_stance(ROBOTS.get("a1"), wider=0.5, longer=0.5, lower=-0.4)


def test_a_stance_of_two_numbers_is_refused():
    with pytest.raises(
        InputError, match=r"stance=\(0.1, 0.1\) has 2 numbers; give three \(wider, longer, lower\), or none"
    ):
        riding("a1", stance=(0.1, 0.1))


def test_a_task_in_another_stance_is_made_again_from_its_arguments():
    task = riding("a1", stance=(0.15, 0.1, 0.1))
    again = make_task(task.name, **task.arguments)
    assert again.robot == task.robot != riding("a1").robot
    assert QuadrupedEnv(task, num_envs=1, num_threads=1).reset()["proprio"].isfinite().all()

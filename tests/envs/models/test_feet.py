"""Feet of several geoms, of meshes, of bodies of their own; shanks beside them are no feet."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from torchrl_atr.envs import ROBOTS, RidingEnv, RobotError
from torchrl_atr.envs.models import RobotSpec, load_robot_model
from torchrl_atr.envs.models.feet import find_feet
from torchrl_atr.envs.tasks.riding.state import RidingState

A1 = ROBOTS.get("a1")
FOOT = r'<geom name="(\w+)_foot" class="foot" pos="0 0 -0.2"/>'
KINDS = {
    "heel and toe": r'<geom name="\1_foot" class="foot" pos="0.015 0 -0.2"/><geom class="foot" pos="-0.015 0 -0.2"/>',
    "three": "".join(
        rf'<geom {name} class="foot" size="0.018" pos="{x} {y} -0.2"/>'
        for name, x, y in ((r'name="\1_foot"', 0.015, 0), ("", -0.015, 0.01), ("", -0.015, -0.01))
    ),
    "pad under a ball": r'<geom name="\1_foot" class="foot" type="box" size="0.02 0.02 0.004" pos="0 0 -0.215" '
    r'euler="0 0.7 0"/><geom class="foot" pos="0 0 -0.2"/>',
    "a body of its own": r'<body name="\1_toes" pos="0 0 -0.2"><geom name="\1_foot" class="foot" pos="0.015 0 0"/>'
    r'<geom class="foot" pos="-0.015 0 0"/><body><geom class="foot" type="box" size=".01 .01 .01"/></body></body>',
    "mesh and sphere": r'<geom name="\1_foot" class="foot" type="mesh" mesh="sole" pos="0 0 -0.2"/>'
    r'<geom class="foot" pos="0 0 -0.2"/>',
}
MESH = '<asset><mesh name="sole" vertex="{}"/></asset><worldbody>'.format(
    " ".join(f"{x} {y} {z}" for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (-0.015, 0.015))
)


def robot_with(folder: Path, foot: str, feet: tuple = A1.feet) -> RobotSpec:
    text, count = re.subn(FOOT, foot, A1.mjcf.read_text())
    assert count == 4
    (folder / "mine.xml").write_text(text.replace("<worldbody>", MESH, 1))
    return dataclasses.replace(A1, name="mine", mjcf=folder / "mine.xml", feet=feet)


def standing(robot: RobotSpec) -> tuple[RidingEnv, RidingState]:
    env = RidingEnv(robot, num_envs=1, seed=0, num_threads=1, randomization="off", pushes=False)
    for _ in range(50):
        env.engine.step(torch.tensor([robot.q0]))
    env.engine.forward()
    return env, env.runner.terms.extractor.read()


@pytest.mark.parametrize("kind", KINDS)
def test_all_geoms_of_a_foot_are_the_foot(tmp_path, kind):
    robot = robot_with(tmp_path, KINDS[kind])
    env, state = standing(robot)
    assert env.scene.layout.foot_sizes == (KINDS[kind].count("<geom"),) * 4
    assert state.contacts.tolist() == [[1.0] * 4]
    weight = 9.81 * env.model.body_subtreemass[env.scene.layout.trunk_body]
    assert state.foot_force[0, :, 2].sum().item() == pytest.approx(weight, rel=0.1)
    assert state.other_force.abs().max() < 1e-3
    data = mujoco.MjData(env.model)
    data.qpos[:] = env.engine.qpos[0]
    mujoco.mj_kinematics(env.model, data)
    for leg, foot in enumerate(find_feet(env.model, robot)):
        np.testing.assert_allclose(state.foot_position[0, leg], data.geom_xpos[list(foot)].mean(0), atol=1e-5)


def test_shanks_are_no_feet():
    for name in ("a1", "go1", "anymal_c", "spot"):
        robot = ROBOTS.get(name)
        _, model = load_robot_model(robot)
        assert find_feet(model, robot) == tuple((model.geom(foot).id,) for foot in robot.feet)


def test_a_list_names_exactly_the_foot(tmp_path):
    foot = (
        r'<geom name="\1_heel" class="foot" pos="-0.015 0 -0.2"/><geom name="\1_toe" class="foot" pos="0.015 0 -0.2"/>'
    )
    legs = ("FR", "RR", "FL", "RL")
    both = robot_with(tmp_path, foot, tuple((f"{leg}_heel", f"{leg}_toe") for leg in legs))
    assert standing(both)[0].scene.layout.foot_sizes == (2,) * 4
    alone = dataclasses.replace(both, feet=tuple([f"{leg}_toe"] for leg in legs))
    env, state = standing(alone)
    assert env.scene.layout.foot_sizes == (1,) * 4
    assert state.other_force.norm() > 1.0  # the heels are collisions now
    with pytest.raises(RobotError, match="'FR_heel' and 'RR_toe' are on different links"):
        load_robot_model(dataclasses.replace(both, feet=(("FR_heel", "RR_toe"), "RR_heel", "FL_heel", "RL_heel")))
    with pytest.raises(RobotError, match="feet holds \\(\\); name one geom, or a list of all geoms"):
        dataclasses.replace(both, feet=((), *both.feet[1:]))

"""Our robots against their makers' numbers and Table IV."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from torchrl_atr.envs.models import LEGS, ROBOTS, Transporter, build_scene, get_transporter, load_robot_model

FACTS: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "robot_facts.json").read_text())
"""By robot: Table IV's total mass; links (of the public model, the trunk scaled to that total) in frames parallel to
the trunk's; legs and joints in our order; where feet, trunk and centre of mass are in q0 with the feet level."""
DECK_TOP = 0.15 + 0.05 / 2


@pytest.fixture(scope="module", params=FACTS)
def robot(request):
    return ROBOTS.get(request.param)


@pytest.fixture(scope="module")
def facts(robot):
    return FACTS[robot.name]


@pytest.fixture(scope="module")
def scene(robot):
    return build_scene(robot, Transporter(get_transporter("single_board", robot)))


def test_every_robot_we_ship_has_facts():
    shipped = {name for name in ROBOTS.names() if ROBOTS.get(name).mjcf.stem == name}  # other tests register their own
    assert shipped == set(FACTS)


def test_total_mass_is_table_iv(scene, facts):
    assert scene.model.body_subtreemass[scene.layout.trunk_body] == pytest.approx(facts["mass"], rel=1e-6)


def test_links_are_the_public_models(scene, facts):
    model = scene.model
    for name, link in facts["links"].items():
        body = model.body(name)
        assert body.mass[0] == pytest.approx(link["mass"], rel=1e-6), name
        np.testing.assert_allclose(body.ipos, link["com"], atol=1e-6, err_msg=name)
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, body.iquat)
        axes = rotation.reshape(3, 3)
        inertia = axes @ np.diag(body.inertia) @ axes.T
        xx, yy, zz, xy, xz, yz = link["inertia"]
        expected = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        np.testing.assert_allclose(inertia, expected, atol=1e-3 * max(xx, yy, zz), err_msg=name)
        if link["parent"] is not None:
            assert model.body(int(body.parentid[0])).name == link["parent"]
            np.testing.assert_allclose(body.pos, link["pos"], atol=1e-6, err_msg=name)
            joint = model.joint(int(body.jntadr[0]))
            np.testing.assert_allclose(joint.axis, link["axis"], atol=1e-6, err_msg=name)


def test_feet_trunk_and_centre_of_mass_stand_where_the_facts_say(robot, scene, facts, stand):
    data, layout = stand(scene.model), scene.layout
    assert scene.model.key(0).name == "stand"
    base = data.xpos[layout.trunk_body]
    for foot, expected in zip(robot.feet, facts["feet"]):
        geom = data.geom(foot)
        np.testing.assert_allclose((geom.xpos - base)[:2], expected, atol=1e-4, err_msg=foot)
        radius = float(scene.model.geom(foot).size[0])
        assert geom.xpos[2] - radius == pytest.approx(DECK_TOP, abs=2e-4), foot
    assert base[2] - DECK_TOP == pytest.approx(facts["base_height"], abs=1e-4)
    quaternion = data.qpos[layout.root_qpos + 3 : layout.root_qpos + 7]
    assert 2 * np.arctan2(quaternion[2], quaternion[0]) == pytest.approx(facts["base_pitch"], abs=1e-4)
    com = data.subtree_com[layout.trunk_body]
    np.testing.assert_allclose(com[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(com - base, facts["com"], atol=1e-4)


def test_joints_are_listed_right_legs_first_from_the_trunk_outwards(robot, scene, facts):
    model, layout = scene.model, scene.layout
    assert LEGS == ("FR", "RR", "FL", "RL")
    assert robot.joints == tuple(facts["joints"])
    np.testing.assert_allclose(robot.q0, facts["q0"])
    driven = [model.joint(int(model.actuator_trnid[actuator, 0])) for actuator in layout.actuators]
    assert [joint.name for joint in driven] == facts["joints"]
    np.testing.assert_array_equal([joint.qposadr[0] for joint in driven], layout.joint_qpos)
    np.testing.assert_array_equal([joint.dofadr[0] for joint in driven], layout.joint_dof)
    np.testing.assert_allclose(model.key_ctrl[0][layout.actuators], robot.q0)
    np.testing.assert_allclose(model.key_qpos[0][layout.joint_qpos], robot.q0)


def test_each_target_moves_its_own_joint_and_foot(robot, scene, stand):
    """The permutation, end to end: bending one joint moves the foot of its leg and no other."""
    model, layout = scene.model, scene.layout
    data = stand(model)
    before = np.stack([data.geom(foot).xpos.copy() for foot in robot.feet])
    for joint, address in enumerate(layout.joint_qpos):
        data.qpos[:] = model.key_qpos[0]
        data.qpos[address] += 0.1
        mujoco.mj_kinematics(model, data)
        moved = np.linalg.norm(np.stack([data.geom(foot).xpos for foot in robot.feet]) - before, axis=1)
        assert np.flatnonzero(moved > 1e-9).tolist() == [joint // 3], robot.joints[joint]


def test_robot_settles_near_its_desired_height(robot):
    """q0 held by the PD controllers on a deck that cannot tilt."""
    scene = build_scene(robot, Transporter(get_transporter("single_board", robot)))
    model = scene.model
    model.jnt_stiffness[scene.support_layout.tilt_joints] = 1e6
    model.dof_damping[scene.support_layout.tilt_dof] = 1e4
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 600)
    height = data.xpos[scene.layout.trunk_body][2] - DECK_TOP
    assert height == pytest.approx(robot.standing_height, abs=0.015)


def test_gains_and_limits_reach_the_actuators(robot):
    spec, _ = load_robot_model(robot)
    model = spec.compile()
    assert model.nu == 12
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], robot.kp)
    np.testing.assert_allclose(model.actuator_biasprm[:, 1:3], [[-robot.kp, -robot.kd]] * 12)
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], robot.torque_limits * 4)
    np.testing.assert_allclose(model.actuator_forcerange[:, 0], -model.actuator_forcerange[:, 1])

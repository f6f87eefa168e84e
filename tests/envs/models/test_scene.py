"""Robots, transporters and the compiled scene against the numbers of their makers and of Table IV."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from torchrl_atr.envs.models import LEGS, ROBOTS, TRANSPORTERS, build_scene, scene_spec
from torchrl_atr.envs.profiles import Readings, get_readings
from torchrl_atr.envs.riding import RidingEnv

A1, BOARD = ROBOTS.get("a1"), TRANSPORTERS.get("single_board")
DECK_TOP = 0.15 + 0.05 / 2
# the public A1: body, mass (the trunk's scaled to Table IV), position in the parent, centre of mass
LINKS = {
    "trunk": (4.0, None, (0.0, 0.0041, -0.0005)),
    "FR_hip": (0.696, (0.183, -0.047, 0.0), (-0.003311, -0.000635, 3.1e-05)),
    "RR_hip": (0.696, (-0.183, -0.047, 0.0), (0.003311, -0.000635, 3.1e-05)),
    "FL_hip": (0.696, (0.183, 0.047, 0.0), (-0.003311, 0.000635, 3.1e-05)),
    "RL_hip": (0.696, (-0.183, 0.047, 0.0), (0.003311, 0.000635, 3.1e-05)),
    **{f"{leg}_thigh": (1.013, (0.0, -0.08505, 0.0), (-0.003237, 0.022327, -0.027326)) for leg in ("FR", "RR")},
    **{f"{leg}_thigh": (1.013, (0.0, 0.08505, 0.0), (-0.003237, -0.022327, -0.027326)) for leg in ("FL", "RL")},
    **{f"{leg}_calf": (0.226, (0.0, 0.0, -0.2), (0.0047266, 0.0, -0.131975)) for leg in LEGS},
}
# in q0 with the feet level, from the base origin in world axes
FEET = {"FR": (0.1741, -0.1608), "RR": (-0.2497, -0.1599), "FL": (0.1741, 0.1608), "RL": (-0.2497, 0.1599)}
BASE_HEIGHT, BASE_PITCH, FOOT_RADIUS = 0.2988, -0.0205, 0.02
CENTRE_OF_MASS = (-0.0136, 0.0014, -0.0201)


@pytest.fixture(scope="module")
def scene():
    return build_scene(A1, BOARD)


@pytest.fixture(scope="module")
def standing(scene):
    data = mujoco.MjData(scene.model)
    mujoco.mj_resetDataKeyframe(scene.model, data, 0)
    mujoco.mj_forward(scene.model, data)
    return data


def test_masses_are_table_iv(scene):
    model, layout = scene.model, scene.layout
    assert model.body_subtreemass[layout.trunk_body] == pytest.approx(11.74, abs=1e-9)
    assert model.body_mass[layout.deck_body] == pytest.approx(11.5)
    assert model.body_mass.sum() == pytest.approx(11.74 + 11.5)


def test_deck_inertia_is_that_of_a_uniform_box(scene):
    length, width, height, mass = 0.9, 0.7, 0.05, 11.5
    expected = mass / 12 * np.array([width**2 + height**2, length**2 + height**2, length**2 + width**2])
    assert BOARD.inertia == pytest.approx(expected)
    np.testing.assert_allclose(scene.model.body_inertia[scene.layout.deck_body], expected)
    np.testing.assert_allclose(expected, [0.472, 0.779, 1.246], atol=5e-4)


@pytest.mark.parametrize("name", LINKS)
def test_links_are_the_public_models(scene, name):
    mass, position, centre = LINKS[name]
    body = scene.model.body(name)
    assert body.mass[0] == pytest.approx(mass, abs=1e-9)
    np.testing.assert_allclose(body.ipos, centre, atol=1e-6)
    if position is not None:
        np.testing.assert_allclose(body.pos, position, atol=1e-6)


def test_the_robot_is_mirror_symmetric_but_for_its_trunk(scene):
    for right, left in (("FR", "FL"), ("RR", "RL")):
        for part in ("hip", "thigh", "calf"):
            a, b = scene.model.body(f"{right}_{part}"), scene.model.body(f"{left}_{part}")
            np.testing.assert_allclose(a.ipos, b.ipos * [1, -1, 1], atol=1e-9)
            np.testing.assert_allclose(a.inertia, b.inertia, rtol=1e-6)


def test_stand_keyframe_is_q0_with_level_feet_on_the_deck(scene, standing):
    model, layout = scene.model, scene.layout
    assert model.key(0).name == "stand"
    base = standing.xpos[layout.trunk_body]
    for leg, expected in FEET.items():
        foot = standing.geom(f"{leg}_foot").xpos
        np.testing.assert_allclose((foot - base)[:2], expected, atol=1e-4)
        assert foot[2] - FOOT_RADIUS == pytest.approx(DECK_TOP, abs=1e-9)
    assert base[2] - DECK_TOP == pytest.approx(BASE_HEIGHT, abs=1e-4)
    quaternion = standing.qpos[layout.root_qpos + 3 : layout.root_qpos + 7]
    assert 2 * np.arctan2(quaternion[2], quaternion[0]) == pytest.approx(BASE_PITCH, abs=1e-4)
    np.testing.assert_allclose(standing.qpos[layout.joint_qpos], A1.q0)
    np.testing.assert_allclose(standing.ctrl[layout.actuators], A1.q0)


def test_stand_keyframe_has_its_centre_of_mass_over_the_pivot(scene, standing):
    com = standing.subtree_com[scene.layout.trunk_body]
    np.testing.assert_allclose(com[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(com - standing.xpos[scene.layout.trunk_body], CENTRE_OF_MASS, atol=1e-4)


def test_joints_and_feet_are_listed_right_legs_first(scene):
    assert LEGS == ("FR", "RR", "FL", "RL")
    model, layout = scene.model, scene.layout
    expected = [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf")]
    joints = [model.joint(int(model.actuator_trnid[actuator, 0])) for actuator in layout.actuators]
    assert [joint.name for joint in joints] == expected
    np.testing.assert_array_equal([joint.qposadr[0] for joint in joints], layout.joint_qpos)
    np.testing.assert_array_equal([joint.dofadr[0] for joint in joints], layout.joint_dof)
    assert A1.feet == tuple(f"{leg}_foot" for leg in LEGS)


def test_self_balancing_gains_follow_their_unit():
    for readings, unit in ((Readings(), 180 / np.pi), (get_readings("literal"), 1.0)):
        scene = build_scene(A1, BOARD, readings)
        tilt, dofs = scene.layout.tilt_joints, scene.layout.tilt_dof
        np.testing.assert_allclose(scene.model.jnt_stiffness[tilt], 1.15 * unit)
        np.testing.assert_allclose(scene.model.dof_damping[dofs], 0.025 * unit)


def test_only_robot_and_deck_collide(scene):
    model, deck = scene.model, scene.layout.deck_geom
    pairs = {
        (i, j)
        for i in range(model.ngeom)
        for j in range(i)
        if (model.geom_contype[i] & model.geom_conaffinity[j]) or (model.geom_contype[j] & model.geom_conaffinity[i])
    }
    assert pairs
    assert all(deck in pair for pair in pairs)


def test_zero_action_stands():
    env = RidingEnv(num_envs=1, seed=0, randomization="off", pushes=False, num_threads=1)
    for _ in range(150):
        env.engine.step(np.array([A1.q0]))
    qpos, layout = env.engine.qpos[0], env.scene.layout
    assert qpos[layout.root_qpos + 2] - DECK_TOP == pytest.approx(A1.standing_height, abs=0.01)
    assert np.linalg.norm(qpos[layout.root_qpos : layout.root_qpos + 2] - qpos[layout.planar_qpos[:2]]) < 0.05
    assert np.abs(qpos[layout.joint_qpos] - A1.q0).max() < 0.2
    assert np.abs(qpos[layout.tilt_qpos]).max() < 0.1
    loads = -env.engine.sensordata[0, layout.sensors["foot_force"]].reshape(4, 3)
    assert loads[:, 2].min() > 10.0
    assert loads[:, 2].sum() == pytest.approx(11.74 * 9.81, rel=0.05)


def test_scene_is_a_file_that_mujoco_opens():
    xml = scene_spec(A1, BOARD, Readings()).to_xml()
    loaded = mujoco.MjModel.from_xml_string(xml)
    assert loaded.key("stand").id == 0
    np.testing.assert_allclose(loaded.key_qpos[0], build_scene(A1, BOARD).model.key_qpos[0], atol=1e-5)
    assert mujoco.MjModel.from_xml_string(xml).nu == 12


@pytest.mark.parametrize(("registry", "kind"), [(ROBOTS, "robot"), (TRANSPORTERS, "transporter")])
def test_unknown_names_list_the_known_ones(registry, kind):
    with pytest.raises(ValueError, match=f"unknown {kind} 'hovercraft'; known: {registry.names()[0]}"):
        registry.get("hovercraft")
    with pytest.raises(ValueError, match="registered already"):
        registry.register(registry.names()[0], registry.get(registry.names()[0]))

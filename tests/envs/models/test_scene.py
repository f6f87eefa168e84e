"""Transporters and the compiled scene against Table IV and the paper's equations."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
import torch

from torchrl_atr.envs.interpretation import Interpretation, get_interpretation
from torchrl_atr.envs.models import (
    LEGS,
    ROBOTS,
    TRANSPORTERS,
    Transporter,
    TransporterError,
    build_scene,
    get_transporter,
    scene_mjspec,
)
from torchrl_atr.envs.riding import RidingEnv

A1, BOARD, A1_BOARDS = ROBOTS.get("a1"), TRANSPORTERS.get("single_board_g1"), TRANSPORTERS.get("two_board_g1")
DECK_TOP = 0.15 + 0.05 / 2


@pytest.fixture(scope="module")
def scene():
    return build_scene(A1, Transporter(BOARD))


def test_masses_are_table_iv(scene):
    model, layout = scene.model, scene.layout
    assert model.body_subtreemass[layout.trunk_body] == pytest.approx(11.74, abs=1e-9)
    assert model.body("platform").subtreemass == pytest.approx(11.5)
    assert model.body_mass.sum() == pytest.approx(11.74 + 11.5)


@pytest.mark.parametrize(("size", "mass"), [("g1", 11.5), ("g2", 30.0)])
@pytest.mark.parametrize("kind", ["single_board", "two_board"])
def test_deck_is_uniform_boxes_of_table_iv(kind, size, mass):
    deck = TRANSPORTERS.get(f"{kind}_{size}")
    robot = ROBOTS.get("a1" if size == "g1" else "spot")
    scene = build_scene(robot, Transporter(deck))
    model, support = scene.model, scene.support_layout
    length, width, height = {"g1": (0.9, 0.7, 0.05), "g2": (1.5, 1.1, 0.05)}[size]
    assert deck.size == (length, width, height)
    assert model.body("platform").subtreemass == pytest.approx(mass)
    boards = len(support.board_geoms)
    own, wide = mass / boards, width / boards
    each = own / 12 * np.array([wide**2 + height**2, length**2 + height**2, length**2 + wide**2])
    for body, geom in zip(support.board_bodies, support.board_geoms):
        np.testing.assert_allclose(model.body_inertia[body], each)
        np.testing.assert_allclose(2 * model.geom_size[geom], [length, wide, height])
    # I*_zz of two touching halves, by the parallel-axis theorem, is that of the undivided board
    whole = mass / 12 * np.array([width**2 + height**2, length**2 + height**2, length**2 + width**2])
    assert deck.inertia == pytest.approx(whole)
    if boards == 2:
        assert deck.inertia[2] == pytest.approx(2 * (each[2] + own * (width / 4) ** 2))


def test_two_boards_lie_side_by_side_with_the_right_legs_on_the_right_one(stand):
    scene = build_scene(A1, Transporter(A1_BOARDS))
    data, support = stand(scene.model), scene.support_layout
    right, left = (data.geom_xpos[geom] for geom in support.board_geoms)
    np.testing.assert_allclose(right[:2], [0.0, -0.175], atol=1e-12)
    np.testing.assert_allclose(left[:2], [0.0, 0.175], atol=1e-12)
    half = A1_BOARDS.size[1] / 4
    for leg, foot in zip(LEGS, A1.feet):
        y = data.geom(foot).xpos[1]
        assert abs(y - (right if leg in ("FR", "RR") else left)[1]) < half, leg


def test_self_balancing_gains_follow_their_unit():
    for interpretation, unit in ((Interpretation(), 180 / np.pi), (get_interpretation("literal"), 1.0)):
        scene = build_scene(A1, Transporter(BOARD, interpretation))
        tilt, dofs = scene.support_layout.tilt_joints, scene.support_layout.tilt_dof
        np.testing.assert_allclose(scene.model.jnt_stiffness[tilt], 1.15 * unit)
        np.testing.assert_allclose(scene.model.dof_damping[dofs], 0.025 * unit)


@pytest.mark.parametrize(("kind", "default"), [("single_board", 5.0), ("two_board", 2.5)])
@pytest.mark.parametrize(("profile", "unit"), [("default", 180 / np.pi), ("literal", 1.0)])
def test_large_decks_carry_scaled_springs_unless_read_literally(profile, unit, kind, default):
    """So that a large robot's centre of mass, as far off the pivot, tilts both kinds of boards alike."""
    deck, scale = TRANSPORTERS.get(f"{kind}_g2"), unit * (default if profile == "default" else 1.0)
    scene = build_scene(ROBOTS.get("spot"), Transporter(deck, get_interpretation(profile)))
    layout = scene.support_layout
    np.testing.assert_allclose(scene.model.jnt_stiffness[layout.tilt_joints], 1.15 * scale)
    np.testing.assert_allclose(scene.model.dof_damping[layout.tilt_dof], 0.025 * scale)


def test_each_gain_of_two_boards_reaches_its_own_board():
    deck = dataclasses.replace(TRANSPORTERS.get("two_board_g1"), sb_stiffness=(1.0, 2.0), sb_damping=(0.01, 0.02))
    model = build_scene(A1, Transporter(deck, get_interpretation("literal"))).model
    joints = [model.joint(f"platform_pitch_{side}") for side in ("right", "left")]
    assert [joint.stiffness[0] for joint in joints] == pytest.approx([1.0, 2.0])
    assert [joint.damping[0] for joint in joints] == pytest.approx([0.01, 0.02])


def test_size_of_the_deck_follows_the_robot_unless_named():
    assert get_transporter("two_board", A1).name == "two_board_g1"
    assert get_transporter("two_board", ROBOTS.get("spot")).name == "two_board_g2"
    assert get_transporter("single_board_g2", A1).name == "single_board_g2"
    with pytest.raises(ValueError, match="unknown transporter 'unicycle'; known: single_board, two_board, single_"):
        get_transporter("unicycle", A1)
    with pytest.raises(ValueError, match=r"'anymal_c'.*off the surface of 'single_board_g1'"):
        build_scene(ROBOTS.get("anymal_c"), Transporter(TRANSPORTERS.get("single_board_g1")))


@pytest.mark.parametrize("field", ["mass", "tilt_norm", "max_acceleration"])
def test_impossible_transporters_are_named(field):
    with pytest.raises(TransporterError, match=f"'single_board_g1': {field}=0.0 must be positive"):
        dataclasses.replace(BOARD, **{field: 0.0})


@pytest.mark.parametrize("transporter", ["single_board_g1", "two_board_g1"])
def test_only_robot_and_boards_collide(transporter):
    scene = build_scene(A1, Transporter(TRANSPORTERS.get(transporter)))
    model, decks = scene.model, set(scene.support_layout.board_geoms.tolist())
    pairs = {
        (i, j)
        for i in range(model.ngeom)
        for j in range(i)
        if (model.geom_contype[i] & model.geom_conaffinity[j]) or (model.geom_contype[j] & model.geom_conaffinity[i])
    }
    assert pairs
    assert all(len(decks & set(pair)) == 1 for pair in pairs)


def test_zero_action_stands():
    env = RidingEnv(num_envs=1, seed=0, randomization="off", pushes=False, num_threads=1)
    for _ in range(150):
        env.engine.step(torch.tensor([A1.q0]))
    qpos, layout, support = env.engine.qpos[0].numpy(), env.scene.layout, env.scene.support_layout
    assert qpos[layout.root_qpos + 2] - DECK_TOP == pytest.approx(A1.standing_height, abs=0.01)
    assert np.linalg.norm(qpos[layout.root_qpos : layout.root_qpos + 2] - qpos[support.planar_qpos[:2]]) < 0.05
    assert np.abs(qpos[layout.joint_qpos] - A1.q0).max() < 0.2
    assert np.abs(qpos[support.tilt_qpos]).max() < 0.1
    loads = -env.engine.sensordata[0, layout.sensors["foot_force"]].reshape(4, 3)
    assert loads[:, 2].min() > 10.0
    assert loads[:, 2].sum().item() == pytest.approx(11.74 * 9.81, rel=0.05)


def test_scene_is_a_file_that_mujoco_opens():
    xml = scene_mjspec(A1, Transporter(BOARD)).to_xml()
    loaded = mujoco.MjModel.from_xml_string(xml)
    assert loaded.key("stand").id == 0
    np.testing.assert_allclose(loaded.key_qpos[0], build_scene(A1, Transporter(BOARD)).model.key_qpos[0], atol=1e-5)
    assert mujoco.MjModel.from_xml_string(xml).nu == 12


@pytest.mark.parametrize(("registry", "kind"), [(ROBOTS, "robot"), (TRANSPORTERS, "transporter")])
def test_unknown_names_list_the_known_ones(registry, kind):
    with pytest.raises(ValueError, match=f"unknown {kind} 'hovercraft'; known: {registry.names()[0]}"):
        registry.get("hovercraft")
    with pytest.raises(ValueError, match="registered already"):
        registry.register(registry.names()[0], registry.get(registry.names()[0]))

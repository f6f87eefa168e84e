"""Robots of one's own: a stranger's MJCF file, a TOML file that describes it, and all that can be wrong with either."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from torchrl_atr.envs import RidingEnv, RobotError, get_robot, read_robot, register_robot
from torchrl_atr.envs.models import ROBOTS, Transporter, build_scene, get_transporter, load_robot_model

A1, GO1 = ROBOTS.get("a1"), ROBOTS.get("go1")
TOML = """
name = "mine"
mjcf = "mine.xml"
trunk = "trunk"
joints = [{joints}]
feet = ["FR_foot", "RR_foot", "FL_foot", "RL_foot"]
q0 = [-0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 0.8, -1.5, 0.1, 1.0, -1.5]
kp = 40.0
kd = 1.0
torque_limits = [23.7, 23.7, 35.55]
action_scale = 0.25
standing_height = 0.3
min_height = 0.15
group = "G1"
""".format(joints=", ".join(f'"{joint}"' for joint in GO1.joints))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A Go1 as strangers write it: floor, light, sensors and actuators of its own in another order."""
    text = GO1.mjcf.read_text()
    surroundings = '<light pos="0 0 3"/><geom name="floor" type="plane" size="0 0 1"/><body name="box" pos="9 9 9"/>'
    text = text.replace("<worldbody>", f"<worldbody>{surroundings}", 1)
    motors = "".join(f'<motor name="m{i}" joint="{joint}"/>' for i, joint in enumerate(reversed(GO1.joints)))
    extras = f'<actuator>{motors}</actuator><sensor><subtreecom body="trunk"/></sensor>'
    text = text.replace("</mujoco>", f'{extras}<option timestep="0.001" gravity="0 0 -3"/></mujoco>')
    (tmp_path / "mine.xml").write_text(text)
    (tmp_path / "mine.toml").write_text(TOML)
    return tmp_path


def test_a_strangers_file_rides_like_ours(folder):
    """What surrounds the robot, drives it or sets the world goes; the robot stays: same ride, bit for bit."""
    theirs = RidingEnv(folder / "mine.toml", num_envs=2, seed=0, num_threads=1)
    ours = RidingEnv(dataclasses.replace(GO1, name="mine"), num_envs=2, seed=0, num_threads=1)
    assert theirs.model.opt.gravity[2] == -9.81
    assert theirs.model.opt.timestep == 0.005
    policy_steps = 20
    a, b = (env.rollout(policy_steps, break_when_any_done=False, auto_reset=True) for env in (theirs, ours))
    assert a["next", "observation"].isfinite().all()
    np.testing.assert_array_equal(a["privileged", "intrinsic"][:, 0], b["privileged", "intrinsic"][:, 0])
    np.testing.assert_allclose(theirs.model.key_qpos, ours.model.key_qpos, atol=1e-12)
    np.testing.assert_allclose(theirs.model.body_mass, ours.model.body_mass)


def test_a_file_by_path_and_a_registered_spec_are_the_same_robot(folder):
    spec = read_robot(folder / "mine.toml")
    assert get_robot(str(folder / "mine.toml")) == spec
    assert spec.mjcf == folder / "mine.xml"
    registered = register_robot(f"mine_{folder.name}", spec)
    assert get_robot(registered.name) == registered


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("kp = 40.0", "kp = -1.0", "kp=-1.0 must be a positive number"),
        ("kp = 40.0", "stiffness = 40.0", "unknown key 'stiffness'"),
        ("kp = 40.0\n", "", "there is no kp; a robot needs"),
        ("trunk =", "trnk =", "unknown key 'trnk'; did you mean 'trunk'?"),
        ("-0.1, 0.8, -1.5, -0.1", "-5.7, 45.8, -85.9, -5.7", "is 45.8: degrees? give radians"),
        ('"FR_hip_joint", ', "", "joints has 11 entries instead of 12; name 3 hinges"),
        ('"FR_foot", ', "", "feet has 3 entries instead of 4"),
        ("min_height = 0.15", "min_height = 0.4", "min_height=0.4 must be below standing_height=0.3"),
        ('group = "G1"', 'group = "G3"', "group='G3' is unknown; choose one of G1, G2"),
        ('"RR_foot"', '"FR_foot"', "feet lists 'FR_foot' twice"),
        ("kp = 40.0", "kp = ", "is not valid TOML"),
    ],
)
def test_a_wrong_spec_file_says_so_before_any_simulation(folder, old, new, message):
    assert old in TOML
    (folder / "mine.toml").write_text(TOML.replace(old, new, 1))
    with pytest.raises(RobotError, match=re.escape(message)):
        read_robot(folder / "mine.toml")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"feet": ("FR_toe", "RR_foot", "FL_foot", "RL_foot")}, "has no geom 'FR_toe' (feet); named geoms at the ends"),
        ({"trunk": "torso"}, "has no root body 'torso' (trunk)"),
        ({"joints": (*A1.joints[:11], "RL_knee_joint")}, "has no joint 'RL_knee_joint'; did you mean"),
        ({"joints": (*A1.joints[3:6], *A1.joints[:3], *A1.joints[6:])}, "leg FR: foot 'FR_foot' hangs on FR_hip_joint"),
        ({"q0": (*A1.q0[:2], 1.5, *A1.q0[3:])}, "q0 of joint 'FR_calf_joint' is 1.5, outside of its range"),
        ({"standing_height": 280.0, "min_height": 0.14}, "standing_height=280, but in q0 'trunk' stands 0.299 m"),
        ({"min_height": 0.29, "standing_height": 0.295}, None),
        ({"mjcf": Path("gone.xml")}, "there is no MJCF file at gone.xml"),
    ],
)
def test_a_spec_that_does_not_fit_its_file_names_the_fix(changes, message):
    robot = dataclasses.replace(A1, **changes)
    if message is None:
        build_scene(robot, Transporter(get_transporter("single_board", robot)))
        return
    with pytest.raises(RobotError, match=re.escape(message)):
        build_scene(robot, Transporter(get_transporter("single_board", robot)))


def test_mirrored_legs_are_found_out():
    legs = [A1.joints[3 * leg : 3 * leg + 3] for leg in range(4)]
    order = (2, 3, 0, 1)  # left legs listed as right ones
    robot = dataclasses.replace(
        A1,
        joints=tuple(joint for leg in order for joint in legs[leg]),
        feet=tuple(A1.feet[leg] for leg in order),
        q0=tuple(angle for leg in order for angle in A1.q0[3 * leg : 3 * leg + 3]),
    )
    with pytest.raises(
        RobotError, match="is front left, but it is listed as FR: list joints, feet and q0 in the order"
    ):
        build_scene(robot, Transporter(get_transporter("single_board", robot)))


def test_a_missing_mesh_is_named(folder):
    text = (
        (folder / "mine.xml").read_text().replace("<worldbody>", '<asset><mesh file="gone.stl"/></asset><worldbody>', 1)
    )
    (folder / "mine.xml").write_text(text)
    with pytest.raises(RobotError, match=r"cannot compile .*mine\.xml: .*gone\.stl"):
        load_robot_model(read_robot(folder / "mine.toml"))


def test_an_undriven_joint_is_named(folder):
    text = (folder / "mine.xml").read_text()
    tail = '<body name="tail" pos="-0.3 0 0"><joint name="wag"/><geom size="0.01" mass="0.01"/></body>'
    text = text.replace('<body name="FR_hip"', f'{tail}<body name="FR_hip"', 1)
    (folder / "mine.xml").write_text(text)
    with pytest.raises(RobotError, match="nothing would drive joint 'wag'"):
        load_robot_model(read_robot(folder / "mine.toml"))


def test_addresses_follow_names_whatever_order_the_file_has(folder):
    scene = build_scene(read_robot(folder / "mine.toml"), Transporter(get_transporter("single_board", GO1)))
    driven = [scene.model.joint(int(scene.model.actuator_trnid[a, 0])).name for a in scene.layout.actuators]
    assert driven == list(GO1.joints)
    np.testing.assert_allclose(scene.model.key_ctrl[0][scene.layout.actuators], GO1.q0)

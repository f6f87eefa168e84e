"""What a robot's MJCF file says of anything but the robot leaves the transporter and the scene as they are."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from torchrl_atr.envs import RobotError
from torchrl_atr.envs.models import (
    ROBOTS,
    TRANSPORTER_DESIGNS,
    RobotSpec,
    Transporter,
    build_scene,
    get_transporter,
    load_robot_model,
    scene_xml,
)

A1 = ROBOTS.get("a1")
TEXT = A1.mjcf.read_text()
SETTINGS = [
    '<size nkey="3"/>',
    '<size njmax="50" nconmax="10" nuserdata="7" nuser_body="3" nuser_geom="2" nuser_jnt="2" nuser_sensor="1"/>',
    '<size memory="100K"/>',
    '<compiler boundmass="2" boundinertia="0.5"/>',
    '<compiler inertiafromgeom="true"/>',
    '<compiler inertiafromgeom="true" inertiagrouprange="2 2"/>',
    '<compiler balanceinertia="true" fitaabb="true" usethread="false"/>',
    '<compiler settotalmass="30"/>',
    '<compiler discardvisual="true"/>',
    '<compiler fusestatic="true"/>',
    '<compiler alignfree="true"/>',
    '<compiler saveinertial="true" strippath="true"/>',
    '<option timestep="0.001" integrator="RK4" cone="elliptic" solver="CG" iterations="3" tolerance="1e-2"/>',
    '<option gravity="0 0 -3" wind="3 0 0" magnetic="1 0 0" density="1.2" viscosity="0.1" impratio="10"/>',
    '<option o_margin="0.1" o_solref="0.1 1" o_friction="0.1 0.1 0 0 0" noslip_iterations="5" jacobian="sparse"/>',
    '<option><flag override="enable" contact="disable" gravity="disable" limit="disable" energy="enable"/></option>',
    '<option><flag sensor="disable" actuation="disable" multiccd="enable" eulerdamp="disable"/></option>',
    '<option actuatorgroupdisable="0 1"/>',
    '<visual><global fovy="20" offwidth="100" offheight="100"/><map znear="0.5" fogstart="2"/></visual>',
    '<visual><headlight active="0" ambient="1 0 0"/><quality shadowsize="77"/><rgba fog="1 0 0 1"/></visual>',
    '<visual><scale contactwidth="0.5"/></visual>',
    '<statistic extent="77" center="1 2 3" meanmass="5" meansize="3" meaninertia="3"/>',
    '<default><geom density="9" margin="0.1" gap="0.05" friction="0.1" condim="6" solimp="0.5 0.6 0.1"/></default>',
    '<default><joint armature="3" damping="3" stiffness="9" frictionloss="2" limited="true" range="-1 1"/></default>',
    '<default><general ctrlrange="-1 1" gear="9" dyntype="filter" group="1"/><light castshadow="false"/></default>',
    '<default><material reflectance="0.9" rgba="1 0 0 1"/><site size="9"/></default>',
    '<custom><numeric name="n" data="1"/><text name="t" data="x"/></custom>',
    '<extension><plugin plugin="mujoco.pid"><instance name="pid"/></plugin></extension>',
]
SCENE_BODIES = ("world", "platform", "deck_right", "deck_left")


def a1_with(folder: Path, *extras: str, **changes: Any) -> RobotSpec:
    """A1 by a file with ``extras`` before its closing tag."""
    path = folder / "mine.xml"
    path.write_text(TEXT.replace("</mujoco>", f"{''.join(extras)}</mujoco>"))
    return dataclasses.replace(A1, name="mine", mjcf=path, **changes)


def fields(structure: Any, prefix: str = "") -> dict[str, Any]:
    names = [name for name in dir(structure) if not name.startswith("_")]
    values = {f"{prefix}{name}": getattr(structure, name) for name in names}
    return {name: np.array(value) for name, value in values.items() if isinstance(value, int | float | np.ndarray)}


def rows_of(model: mujoco.MjModel, kind: str, belongs: Any) -> dict[str, np.ndarray]:
    """The fields of ``kind`` (such as ``"geom"``) of elements that ``belongs`` says are the scene's, by name."""
    count = {"jnt": "njnt", "dof": "nv", "actuator": "nu"}.get(kind, f"n{kind}")
    values = {name: value for name, value in fields(model).items() if name.startswith(f"{kind}_")}
    rows = [i for i in range(getattr(model, count)) if belongs(i)]
    return {name: value[rows] for name, value in values.items() if value.ndim and len(value) == getattr(model, count)}


ROBOTS_OWN = ("id", "adr", "num", "invweight", "length0", "acc0", "subtreemass", "name", "armature", "M0", "poscom0")
"""Words in the names of fields that depend on how large and heavy the robot is, or where its elements are stored."""


def scene_fields(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """All that is not the robot's: options, visuals, and the fields of the scene's elements."""
    bodies = {i for i in range(model.nbody) if model.body(i).name in SCENE_BODIES}
    sizes = ("nkey", "nu", "nsensor", "nuserdata", "nuser_body", "narena", "nlight", "ncam", "nnumeric", "nplugin")
    found = {"sizes": np.array([getattr(model, name) for name in sizes]), **fields(model.opt, "opt.")}
    for part in ("global_", "headlight", "map", "quality", "rgba", "scale"):
        found |= fields(getattr(model.vis, part), f"vis.{part}.")
    for kind, body in {"geom": model.geom_bodyid, "jnt": model.jnt_bodyid, "dof": model.dof_bodyid}.items():
        found |= rows_of(model, kind, lambda i, body=body: body[i] in bodies)
    found |= rows_of(model, "body", lambda i: i in bodies)
    for kind in ("actuator", "sensor", "light", "mat"):
        found |= rows_of(model, kind, lambda i: True)
    return {name: value for name, value in found.items() if not any(word in name for word in ROBOTS_OWN)}


def boards(transporter: str, robot: RobotSpec) -> Transporter:
    return Transporter(get_transporter(transporter, robot))


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
@pytest.mark.parametrize("transporter", TRANSPORTER_DESIGNS)
@pytest.mark.parametrize("setting", SETTINGS)
def test_settings_of_a_robots_file_stay_out_of_the_scene(tmp_path, setting, transporter):
    deck = boards(transporter, A1)
    expected = scene_fields(build_scene(A1, deck).model)
    scene = build_scene(a1_with(tmp_path, setting), deck)
    found = scene_fields(scene.model)
    assert len(expected) > 150
    assert not [name for name in expected if not np.array_equal(expected[name], found[name])]
    armature = scene.model.dof_armature[scene.support_layout.planar_dof]
    np.testing.assert_allclose(armature, 200.0 * scene.model.body_subtreemass[scene.layout.trunk_body])
    assert scene.model.key(0).name == "stand"
    assert scene.model.nkey == 1


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
@pytest.mark.parametrize(
    "setting",
    [
        '<compiler boundmass="2" boundinertia="0.01"/>',
        '<compiler settotalmass="30"/>',
        '<compiler inertiafromgeom="true" inertiagrouprange="3 3"/>',
        '<compiler balanceinertia="true"/>',
    ],
)
def test_settings_that_shape_the_robots_own_bodies_are_kept(tmp_path, setting):
    text = TEXT.replace(
        '<geom contype="1" conaffinity="0" group="3" mass="0"', '<geom contype="1" group="3" mass="0.5"'
    )
    robot = a1_with(tmp_path, setting)
    robot.mjcf.write_text(text.replace("</mujoco>", f"{setting}</mujoco>"))
    alone = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    model = build_scene(robot, boards("two_board", robot)).model
    for name in (alone.body(i).name for i in range(1, alone.nbody)):
        for field in ("mass", "inertia", "ipos", "iquat"):
            ours, theirs = (getattr(of.body(name), field) for of in (model, alone))
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-15, err_msg=f"{field} of {name}")


def test_degrees_and_explicit_limits_are_the_robots_own(tmp_path):
    degrees = TEXT.replace('<compiler angle="radian" autolimits="true"/>', '<compiler autolimits="false"/>')
    degrees = re.sub(
        r'range="(\S+) (\S+)"',
        lambda m: f'limited="true" range="{np.degrees(float(m[1])):.12g} {np.degrees(float(m[2])):.12g}"',
        degrees,
    ).replace('euler="1.5707963 0 0"', 'euler="90 0 0"')
    robot = a1_with(tmp_path)
    robot.mjcf.write_text(degrees)
    ours, theirs = (build_scene(each, boards("two_board", A1)).model for each in (A1, robot))
    np.testing.assert_allclose(theirs.jnt_range, ours.jnt_range, atol=1e-9)
    np.testing.assert_allclose(theirs.actuator_ctrlrange, ours.actuator_ctrlrange, atol=1e-9)
    np.testing.assert_array_equal(theirs.jnt_limited, ours.jnt_limited)


SURROUNDINGS = """<geom name="ground" type="plane" size="0 0 1"/><site name="post"/><light pos="0 0 3"/>
  <camera name="outside" mode="targetbody" target="trunk"/>
  <frame pos="9 9 9">
    <body name="box"><joint name="lid"/><site name="handle"/><geom name="side" size="1"/></body>
  </frame>"""
ON_ROBOT = """<freejoint name="root"/><site name="chest"/><camera name="follower" mode="targetbody" target="box"/>
  <camera name="eye"/><light mode="targetbody" target="box"/>"""
REFERENCES = """
<equality>
  <weld body1="trunk" body2="box"/><connect body1="trunk" anchor="0 0 0"/><connect site1="post" site2="chest"/>
  <joint joint1="FR_hip_joint" joint2="lid"/><joint name="kept" joint1="FR_hip_joint" joint2="FL_hip_joint"/>
  <tendon tendon1="rope"/>
</equality>
<contact>
  <exclude body1="trunk" body2="box"/><pair geom1="ground" geom2="FR_foot"/><pair geom1="FL_foot" geom2="FR_foot"/>
</contact>
<tendon>
  <spatial name="rope"><site site="post"/><site site="chest"/></spatial>
  <spatial name="string"><site site="handle"/><site site="chest"/></spatial>
  <fixed name="coupling"><joint joint="FR_hip_joint" coef="1"/></fixed>
</tendon>
<sensor>
  <framepos objtype="body" objname="trunk" reftype="body" refname="box"/><framepos objtype="site" objname="post"/>
  <jointpos joint="lid"/><tendonpos tendon="rope"/><rangefinder site="chest"/>
</sensor>
<extension><plugin plugin="mujoco.pid"><instance name="pid"/></plugin></extension>
<actuator>
  <motor joint="FR_hip_joint"/><motor joint="lid"/><motor tendon="rope"/><motor site="chest" refsite="post"/>
  <plugin plugin="mujoco.pid" instance="pid" joint="FR_hip_joint"/>
</actuator>
<custom><tuple name="parts"><element objtype="body" objname="box"/></tuple></custom>
<deformable><skin name="cloth" vertex="0 0 0 1 0 0 0 1 0" face="0 1 2">
  <bone body="trunk" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1" vertweight="1 1"/>
  <bone body="box" bindpos="0 0 0" bindquat="1 0 0 0" vertid="2" vertweight="1"/>
</skin></deformable>
<keyframe><key name="home" time="3"/></keyframe>"""


def test_what_refers_to_removed_things_goes_too(tmp_path):
    robot = a1_with(tmp_path, REFERENCES)
    text = robot.mjcf.read_text().replace("<worldbody>", f"<worldbody>{SURROUNDINGS}", 1)
    robot.mjcf.write_text(text.replace('<freejoint name="root"/>', ON_ROBOT, 1))
    mujoco.MjModel.from_xml_path(str(robot.mjcf))  # all of it is valid
    spec, _ = load_robot_model(robot)
    assert [camera.name for camera in spec.cameras] == ["eye"]
    assert [equality.name for equality in spec.equalities] == ["kept"]
    assert [tendon.name for tendon in spec.tendons] == ["coupling"]
    assert [site.name for site in spec.sites] == ["chest"]
    assert not [*spec.skins, *spec.sensors, *spec.keys, *spec.pairs, *spec.excludes, *spec.tuples, *spec.plugins]
    assert len(spec.actuators) == 12
    build_scene(robot, boards("two_board", robot))


@pytest.mark.parametrize(
    ("old", "new", "culprit"),
    [
        ('body name="FR_hip"', 'body name="platform"', "body 'platform'"),
        ('body name="FR_hip"', 'body name="deck_left"', "body 'deck_left'"),
        ('<geom class="visual"', '<geom name="floor" class="visual"', "geom 'floor'"),
        ('<geom class="visual"', '<geom name="deck_right" class="visual"', "geom 'deck_right'"),
        ('name="root"', 'name="platform_x"', "joint 'platform_x'"),
        ('name="root"', 'name="platform_pitch_left"', "joint 'platform_pitch_left'"),
        ('<geom class="visual"', '<geom material="scene_floor" class="visual"', "material 'scene_floor'"),
    ],
)
def test_a_name_of_the_scenes_own_is_refused(tmp_path, old, new, culprit):
    robot = a1_with(tmp_path)
    text = TEXT.replace("<worldbody>", '<asset><material name="scene_floor"/></asset><worldbody>')
    robot.mjcf.write_text(text.replace(old, new, 1))
    with pytest.raises(RobotError, match=f"{culprit}; give it another name in a copy of"):
        build_scene(robot, boards("two_board", robot))


def test_names_of_what_is_removed_do_not_clash(tmp_path):
    """A scene that we wrote is a robot's file like any other: its floor, lights and boards go."""
    path = tmp_path / "scene.xml"
    path.write_text(scene_xml(A1, boards("single_board", A1)))
    again = build_scene(dataclasses.replace(A1, mjcf=path), boards("single_board", A1))
    ours = build_scene(A1, boards("single_board", A1))
    np.testing.assert_array_equal(again.model.key_qpos, ours.model.key_qpos)
    np.testing.assert_array_equal(again.model.body_mass, ours.model.body_mass)


def simulate(model: mujoco.MjModel, substeps: int = 300) -> np.ndarray:
    """``qpos``, ``qvel`` and sensors from the standing pose on, with the same random targets every time."""
    data, generator, states = mujoco.MjData(model), np.random.default_rng(0), []
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    for step in range(substeps):
        if step % 4 == 0:
            data.ctrl[:] = model.key("stand").ctrl + 0.2 * generator.standard_normal(model.nu)
        mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
    return np.stack(states)


@pytest.mark.parametrize("transporter", TRANSPORTER_DESIGNS)
@pytest.mark.parametrize("name", ["a1", "go1", "anymal_c", "spot"])
def test_a_scene_written_to_a_file_simulates_the_same_bit_for_bit(tmp_path, name, transporter):
    robot = ROBOTS.get(name)
    deck, path = boards(transporter, robot), tmp_path / "scene.xml"
    path.write_text(scene_xml(robot, deck))
    np.testing.assert_array_equal(
        simulate(mujoco.MjModel.from_xml_path(str(path))), simulate(build_scene(robot, deck).model)
    )


def attached(folder: Path, text: str) -> RobotSpec:
    """A robot whose file does nothing but attach another one, in a folder below, without a prefix."""
    (folder / "parts").mkdir(parents=True)
    (folder / "parts" / "robot.xml").write_text(text)
    path = folder / "main.xml"
    path.write_text(
        '<mujoco><compiler angle="degree" meshdir="nowhere"/><asset><model name="r" file="parts/robot.xml"/></asset>'
        '<worldbody><frame pos="1 2 3"><attach model="r" body="trunk" prefix=""/></frame></worldbody></mujoco>'
    )
    return dataclasses.replace(A1, name="mine", mjcf=path)


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
@pytest.mark.filterwarnings("ignore:Attaching a spec with an empty prefix")
@pytest.mark.parametrize(
    "setting",
    [
        "",
        'boundmass="1"',
        'settotalmass="20"',
        'balanceinertia="true" alignfree="true"',
        'inertiafromgeom="true" inertiagrouprange="2 2"',
        'meshdir="m"',
    ],
)
def test_a_robot_that_attaches_another_model_is_that_model_and_can_be_written(tmp_path, setting):
    """The attached file has compiler settings, global defaults and meshes of its own."""
    text = TEXT.replace('angle="radian"', f'angle="radian" {setting}').replace(
        "<default>", '<default><geom condim="4" friction="0.3 0.1 0.1"/><joint damping="0.3"/>', 1
    )
    text = text.replace('<freejoint name="root"/>', '<freejoint name="root"/><geom size="0.01" mass="0.001"/>')
    text = text.replace('<geom type="sphere" size="0.02"', '<geom type="mesh" mesh="foot"')
    file = "foot.obj" if "meshdir" in setting else "m/foot.obj"
    asset = f'<asset><mesh name="foot" file="{file}" scale="0.02 0.02 0.02"/></asset>'
    robot = attached(tmp_path / "source", text.replace("<worldbody>", f"{asset}<worldbody>"))
    (tmp_path / "source" / "parts" / "m").mkdir()
    (tmp_path / "source" / "parts" / "m" / "foot.obj").write_text(MESH)
    alone = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    deck, path = boards("two_board", robot), tmp_path / "scene.xml"
    scene = build_scene(robot, deck)
    for name in (alone.body(i).name for i in range(1, alone.nbody)):
        for field in ("mass", "inertia", "ipos", "iquat"):
            ours, theirs = (getattr(of.body(name), field) for of in (scene.model, alone))
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-15, err_msg=f"{field} of {name}")
    path.write_text(scene_xml(robot, deck))
    np.testing.assert_array_equal(simulate(mujoco.MjModel.from_xml_path(str(path))), simulate(scene.model))


def test_a_foot_may_be_called_as_the_scenes_sensors_are(tmp_path):
    names = ("robot", "com", "FL_foot", "RL_foot")
    robot = a1_with(tmp_path, feet=names)
    robot.mjcf.write_text(TEXT.replace('"FR_foot"', '"robot"').replace('"RR_foot"', '"com"'))
    ours, theirs = (build_scene(each, boards("single_board", A1)) for each in (A1, robot))
    np.testing.assert_array_equal(simulate(ours.model), simulate(theirs.model))
    assert ours.layout.sensors == theirs.layout.sensors


def test_names_of_any_kind_are_written(tmp_path):
    robot = a1_with(tmp_path, trunk="trünk 😀", feet=("FR <&\"' ü", *A1.feet[1:]))
    text = TEXT.replace('"FR_foot"', '"FR &lt;&amp;&quot;\' ü"').replace('name="trunk"', 'name="trünk 😀"')
    robot.mjcf.write_text(text, encoding="utf-8")
    robot = dataclasses.replace(robot, name='my "robot" <&>')
    deck, path = boards("two_board", robot), tmp_path / "scene.xml"
    path.write_text(scene_xml(robot, deck), encoding="utf-8")
    np.testing.assert_array_equal(
        simulate(mujoco.MjModel.from_xml_path(str(path))), simulate(build_scene(robot, deck).model)
    )


CORNERS = "\n".join(f"v {x} {y} {z}" for x in (-1, 1) for y in (-1, 1) for z in (-1, 1))
MESH = f"{CORNERS}\nf 1 2 3\nf 5 6 7\nf 1 4 8\n"


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
@pytest.mark.parametrize("setting", ["", '<compiler boundmass="1" inertiafromgeom="true"/>', '<size nkey="2"/>'])
def test_a_robot_of_meshes_and_settings_is_written_anywhere(tmp_path, setting):
    """Meshes are found from wherever the scene is written to, and the file has no setting that would act twice."""
    (tmp_path / "robot" / "assets").mkdir(parents=True)
    (tmp_path / "robot" / "assets" / "foot.obj").write_text(MESH)
    robot = a1_with(tmp_path / "robot", '<compiler meshdir="assets"/>', setting)
    text = robot.mjcf.read_text().replace(
        '<geom type="sphere" size="0.02"', '<geom type="mesh" mesh="foot" mass="0.01"'
    )
    asset = '<asset><mesh name="foot" file="foot.obj" scale="0.02 0.02 0.02"/></asset>'
    robot.mjcf.write_text(text.replace("<worldbody>", f"{asset}<worldbody>"))
    (tmp_path / "elsewhere").mkdir()
    deck, path = boards("two_board", robot), tmp_path / "elsewhere" / "scene.xml"
    path.write_text(scene_xml(robot, deck))
    np.testing.assert_array_equal(
        simulate(mujoco.MjModel.from_xml_path(str(path))), simulate(build_scene(robot, deck).model)
    )

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
from torchrl_atr.envs.models import DESIGNS, ROBOTS, RobotSpec, build_scene, get_transporter, load_robot, scene_spec
from torchrl_atr.envs.profiles import Readings

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
    '<compiler autolimits="false"/>',
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
    '<default><geom density="9" margin="0.1" gap="0.05" friction="0.1" condim="6" group="4" solimp="0.5 0.6 0.1"/></default>',
    '<default><joint armature="3" damping="3" stiffness="9" frictionloss="2" limited="true" range="-1 1"/></default>',
    '<default><general ctrlrange="-1 1" gear="9" dyntype="filter" group="1"/><light castshadow="false"/></default>',
    '<default><material reflectance="0.9" rgba="1 0 0 1"/><site size="9"/></default>',
    '<custom><numeric name="n" data="1"/><text name="t" data="x"/></custom>',
    '<extension><plugin plugin="mujoco.pid"><instance name="pid"><config key="kp" value="4"/></instance></plugin></extension>',
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


def scene_fields(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """All that is not the robot's: options, visuals, and the fields of the scene's elements; addresses left out."""
    bodies = {i for i in range(model.nbody) if model.body(i).name in SCENE_BODIES}
    found = {
        **fields(model.opt, "opt."),
        **{
            name: v
            for part in dir(model.vis)
            if part[0] != "_"
            for name, v in fields(getattr(model.vis, part), f"vis.{part}.").items()
        },
        **rows_of(model, "body", lambda i: i in bodies),
        **rows_of(model, "geom", lambda i: model.geom_bodyid[i] in bodies),
        **rows_of(model, "jnt", lambda i: model.jnt_bodyid[i] in bodies),
        **rows_of(model, "dof", lambda i: model.dof_bodyid[i] in bodies),
        **rows_of(model, "actuator", lambda i: True),
        **rows_of(model, "sensor", lambda i: True),
        **rows_of(model, "light", lambda i: True),
        **rows_of(model, "mat", lambda i: True),
        "sizes": np.array(
            [model.nkey, model.nu, model.nsensor, model.nuserdata, model.narena, model.nlight, model.ncam]
        ),
    }
    robots = (
        "id",
        "adr",
        "num",
        "invweight",
        "length0",
        "acc0",
        "subtreemass",
        "name",
        "armature",
        "M0",
        "poscom0",
        "dof_length",
    )
    return {name: value for name, value in found.items() if not any(word in name for word in robots)}


@pytest.mark.parametrize("transporter", DESIGNS)
@pytest.mark.parametrize("setting", SETTINGS)
def test_settings_of_a_robots_file_stay_out_of_the_scene(tmp_path, setting, transporter):
    deck = get_transporter(transporter, A1)
    plain = build_scene(A1, deck)
    scene = build_scene(a1_with(tmp_path, setting), deck)
    expected, found = scene_fields(plain.model), scene_fields(scene.model)
    assert len(expected) > 150
    differing = [name for name in expected if not np.array_equal(expected[name], found[name])]
    assert not differing
    ratio = scene.model.dof_armature[scene.layout.planar_dof] / scene.model.body_subtreemass[scene.layout.trunk_body]
    np.testing.assert_allclose(ratio, 200.0)
    assert scene.model.key(0).name == "stand"

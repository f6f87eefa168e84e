"""Two models are compared by what decides how they move, and what differs is named."""

from __future__ import annotations

import dataclasses
import json

import pytest

from torchrl_atr.envs import ROBOTS
from torchrl_atr.envs.models import Transporter, build_scene, get_transporter
from torchrl_atr.envs.models.identity import describe, differences, digest

A1 = ROBOTS.get("a1")
DECK = get_transporter("single_board", A1)


def description(robot=A1, transporter=DECK):
    return describe(build_scene(robot, Transporter(transporter)))


@pytest.fixture(scope="module")
def ours():
    return description()


def test_a_description_is_plain_and_the_same_wherever_the_file_is(ours, tmp_path):
    (tmp_path / "copy.xml").write_text(A1.mjcf.read_text())
    other = description(dataclasses.replace(A1, name="b1", mjcf=tmp_path / "copy.xml"))
    assert differences(ours, other) == []
    assert digest(ours) == digest(other)
    assert json.loads(json.dumps(ours)) == ours


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"kp": 60.0}, "the robot's kp: 40 then, 60 now"),
        ({"action_scale": 0.5}, "the robot's action_scale: 0.25 then, 0.5 now"),
        ({"torque_limits": (33.5, 33.5, 20.0)}, "the robot's torque_limits: 33.5 then, 20 now"),
        ({"min_height": 0.1}, "the robot's min_height: 0.14 then, 0.1 now"),
    ],
)
def test_a_changed_fact_of_a_robot_is_named(ours, changes, expected):
    assert differences(ours, description(dataclasses.replace(A1, **changes)))[0] == expected


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"max_acceleration": 6.0}, "the transporter's max_acceleration: 12 then, 6 now"),
        ({"resistance": (0.2, 0.05, 0.01)}, "the transporter's resistance: 0.005 then, 0.01 now"),
        ({"mass": 20.0}, "the transporter's mass: 11.5 then, 20 now"),
    ],
)
def test_a_changed_fact_of_a_transporter_is_named_and_is_none_of_the_robot(ours, changes, expected):
    other = description(transporter=dataclasses.replace(DECK, **changes))
    assert differences(ours, other)[0] == expected
    assert differences(ours, other, ["robot"]) == []


def test_another_transporter_leaves_the_robot_as_it_is_and_the_other_way_round(ours):
    other = description(transporter=get_transporter("two_board", A1))
    assert differences(ours, other, ["robot"]) == []
    assert differences(ours, other, ["transporter"])
    assert differences(ours, description(ROBOTS.get("go1")), ["transporter"]) == []


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('mass="1.013"', 'mass="2"', "body_mass of body FR_thigh: 1.013 then, 2 now"),
        ('name="FR_thigh_joint"', 'name="FR_thigh_joint" damping="3"', "dof_damping of joint FR_thigh_joint"),
        ("</worldbody>", '</worldbody><option density="9"/>', None),  # the scene's own
        ('<geom name="FR_foot"', '<geom size="0.05" mass="0"/><geom name="FR_foot"', "geom on FR_calf (2) is new"),
    ],
)
def test_a_changed_file_is_named_by_field_and_element(ours, tmp_path, old, new, expected):
    text = A1.mjcf.read_text()
    assert old in text
    (tmp_path / "a1.xml").write_text(text.replace(old, new, 1))
    found = differences(ours, description(dataclasses.replace(A1, mjcf=tmp_path / "a1.xml")))
    assert found == [] if expected is None else any(text.startswith(expected) for text in found), found


def test_what_is_only_looked_at_does_not_count(ours, tmp_path):
    text = A1.mjcf.read_text().replace('name="FR_thigh"', 'name="FR_thigh" user="1 2"', 1)
    extra = '<geom type="box" size="0.01 0.01 0.01" rgba="1 0 0 1" contype="0" conaffinity="0" mass="0"/><freejoint'
    (tmp_path / "a1.xml").write_text(text.replace("<freejoint", extra, 1))
    assert differences(ours, description(dataclasses.replace(A1, mjcf=tmp_path / "a1.xml"))) == []


def test_rounding_and_fields_of_other_versions_do_not_count(ours):
    other = json.loads(json.dumps(ours))
    body = other["robot"]["body trunk"]
    body["body_mass"] *= 1 + 1e-9
    body["a_field_of_tomorrow"] = [1.0]
    del body["body_gravcomp"]
    assert differences(ours, other) == []
    del other["robot"]["body FL_calf"]
    assert differences(ours, other) == ["body FL_calf is gone"]

"""Feet of standing robots stay where they are."""

from __future__ import annotations

import math

import mujoco
import pytest

from benchmarks.contact_creep import LIMITS, SOFT, creep
from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene, get_transporter, scene_xml
from torchrl_atr.envs.models.boards import Transporter
from torchrl_atr.envs.models.contacts import CONTACTS, ContactModel
from torchrl_atr.envs.models.identity import describe, differences
from torchrl_atr.envs.models.scene import Scene

SUPPORTS = (FlatGround(), Transporter(get_transporter("single_board_g1", ROBOTS.get("a1"))))


def a1(support) -> Scene:
    return build_scene(ROBOTS.get("a1"), support)


def options(model) -> ContactModel:
    return ContactModel(model.opt.cone, model.opt.impratio, model.opt.noslip_iterations)


@pytest.mark.parametrize("support", SUPPORTS, ids=lambda support: support.name)
def test_every_scene_has_them_and_so_has_its_file(support):
    assert options(a1(support).model) == CONTACTS
    xml = scene_xml(ROBOTS.get("a1"), support)
    assert options(mujoco.MjModel.from_xml_string(xml)) == CONTACTS


@pytest.mark.parametrize(("robot", "transporter"), [("go1", "single_board"), ("spot", "two_board")])
def test_feet_stay_where_they_are_standing_accelerating_and_turning(robot, transporter):
    found = creep(robot, transporter, seconds=8.0, settle=4.0)
    assert found.keys() == LIMITS.keys()
    assert all(found[motion] < limit for motion, limit in LIMITS.items()), found


def test_with_mujocos_own_defaults_they_creep():
    found = creep("go1", "single_board", SOFT, seconds=8.0, settle=4.0)
    assert found["standing"] > 2 * LIMITS["standing"]
    assert (found["accelerating"] or math.inf) > 10 * LIMITS["accelerating"]


def test_a_scene_is_the_same_robots_on_other_contacts():
    scene = a1(SUPPORTS[1])
    then = describe(scene)
    SOFT.write(scene.model.opt)
    assert differences(then, describe(scene)) == []
    scene.model.opt.gravity[2] = -1.6
    assert differences(then, describe(scene))

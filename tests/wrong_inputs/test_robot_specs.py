"""Wrong robots, from the command line; ``tests/envs/models/test_robot_file.py`` has more of them."""

from __future__ import annotations

import dataclasses
import json

import pytest

from torchrl_atr.envs import ROBOTS

A1 = ROBOTS.get("a1")
FACTS = {field.name: getattr(A1, field.name) for field in dataclasses.fields(A1)}
MESH = '<asset><mesh file="gone.stl"/></asset><worldbody>'


@pytest.mark.parametrize(
    ("changes", "mjcf", "culprit", "remedy"),
    [
        ({"stiffness": 40.0}, None, "unknown key 'stiffness'", "there are name, mjcf"),
        ({"trnk": "trunk"}, None, "unknown key 'trnk'", "did you mean 'trunk'?"),
        ({"kp": None}, None, "there is no kp", "a robot needs"),
        ({"kp": "strong"}, None, "kp='strong'", "a positive number"),
        ({"q0": [45.0, *A1.q0[1:]]}, None, "q0 of joint 'FR_hip_joint' is 45", "give radians"),
        ({"joints": A1.joints[1:]}, None, "joints has 11 entries instead of 12", "name 3 hinges for each"),
        ({"feet": ("FR_fot", *A1.feet[1:])}, None, "no geom 'FR_fot' (feet)", "named geoms at the ends of its legs"),
        ({"trunk": "torso"}, None, "no root body 'torso'", "there are trunk"),
        ({"group": "G3"}, None, "group='G3'", "choose one of G1, G2"),
        ({"min_height": 0.5}, None, "min_height=0.5", "must be below standing_height"),
        ({"mjcf": "gone.xml"}, None, "no MJCF file at", "check mjcf"),
        ({}, ("<worldbody>", MESH), "gone.stl", "looked up in its folder"),
        ({}, ("</mujoco>", ""), "MuJoCo cannot compile", "Does it open in"),
        ({}, ("<freejoint", "<!-- none --><site"), "'trunk' has no free joint", "write <freejoint/> into it"),
    ],
)
def test_refused(refused, tmp_path, changes, mjcf, culprit, remedy):
    text = A1.mjcf.read_text()
    (tmp_path / "mine.xml").write_text(text if mjcf is None else text.replace(*mjcf, 1))
    facts = {**FACTS, "mjcf": "mine.xml", **changes}
    lines = [f"{name} = {json.dumps(value)}" for name, value in facts.items() if value is not None]
    (tmp_path / "mine.toml").write_text("\n".join(lines))
    scene = tmp_path / "scene.xml"
    refused(["model", tmp_path / "mine.toml", "single_board", "--output", scene], culprit, remedy)
    assert not scene.exists()


def test_a_lopsided_robot_is_not_trained_symmetrically(refused, tmp_path):
    q0 = [A1.q0[0], A1.q0[1] + 0.02, *A1.q0[2:]]
    lines = [f"{name} = {json.dumps(value)}" for name, value in {**FACTS, "mjcf": str(A1.mjcf), "q0": q0}.items()]
    (tmp_path / "mine.toml").write_text("\n".join(lines))
    train = ["train", "--robot", tmp_path / "mine.toml", "--output", tmp_path / "run", "--num-envs", "2"]
    refused(train, "'FR_thigh_joint' is not the mirror image of 'FL_thigh_joint'", "symmetric=false")


@pytest.mark.parametrize(
    ("name", "data", "culprit", "remedy"),
    [
        ("nowhere.toml", None, "no robot file", "check its path"),
        ("mine.toml", b"name: mine", "mine.toml is not valid TOML", "at line 1"),
        ("mine.toml", b"\xff\xfe", "mine.toml is not valid TOML", "position 0"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(refused, tmp_path, name, data, culprit, remedy):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    refused(["train", "--robot", tmp_path / name, "--output", tmp_path / "run"], culprit, remedy)

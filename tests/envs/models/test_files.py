"""Copies of a robot's files: nothing is missing, nothing points to the originals."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.own_robot import write_robot
from torchrl_atr.envs import RobotError, get_robot
from torchrl_atr.envs.models import Transporter, build_scene, get_transporter
from torchrl_atr.envs.models.files import copy_robot, dependencies
from torchrl_atr.envs.models.identity import describe, differences

EVERYTHING = {"mine.toml", "mine.xml", "more.xml", "a.stl", "t.png"}


def description(toml: Path):
    robot = get_robot(toml)
    return describe(build_scene(robot, Transporter(get_transporter("single_board", robot))))


@pytest.mark.parametrize(
    "absolute", ["", "toml", "folders", "files", "include", "toml folders files include", "folders files"]
)
def test_a_copy_that_was_moved_is_the_same_robot_without_the_originals(tmp_path, absolute):
    toml = write_robot(tmp_path / "source", absolute)
    original, text = description(toml), toml.read_text()
    copy = copy_robot(toml, tmp_path / "copy").relative_to(tmp_path / "copy")
    shutil.rmtree(tmp_path / "source")
    shutil.move(tmp_path / "copy", tmp_path / "elsewhere" / "deeper")
    moved = tmp_path / "elsewhere" / "deeper"
    assert {file.name for file in moved.rglob("*") if file.is_file()} == EVERYTHING
    assert differences(original, description(moved / copy)) == []
    for file in (*moved.rglob("*.xml"), *moved.rglob("*.toml")):
        assert str(tmp_path) not in file.read_text()
    if absolute == "":
        assert (moved / copy).read_text() == text  # what is relative is not touched


def test_files_that_lie_apart_keep_their_places_to_each_other(tmp_path):
    write_robot(tmp_path / "robots" / "go1")
    toml = tmp_path / "work" / "mine.toml"
    toml.parent.mkdir()
    text = (tmp_path / "robots" / "go1" / "mine.toml").read_text()
    toml.write_text(text.replace('"xml/mine.xml"', '"../robots/go1/xml/mine.xml"'))
    copy = copy_robot(toml, tmp_path / "copy")
    assert copy == tmp_path / "copy" / "work" / "mine.toml"
    read = [file.relative_to(tmp_path / "copy").parts[0] for file in dependencies(get_robot(copy).mjcf)]
    assert read == ["robots"] * 4


def test_links_are_followed(tmp_path):
    toml = write_robot(tmp_path / "source")
    shutil.move(tmp_path / "source" / "assets", tmp_path / "meshes")
    (tmp_path / "source" / "assets").symlink_to(tmp_path / "meshes")
    original = description(toml)
    copy = copy_robot(toml, tmp_path / "copy")
    shutil.rmtree(tmp_path / "meshes")
    assert differences(original, description(copy)) == []
    assert not any(path.is_symlink() for path in (tmp_path / "copy").rglob("*"))


def test_paths_of_any_characters(tmp_path):
    toml = write_robot(tmp_path / "so urce 😀", "toml folders files include")
    original = description(toml)
    copy = copy_robot(toml, tmp_path / "copy")
    assert "😀" not in copy.read_text(encoding="utf-8")
    apart = tmp_path / "apart" / "mine.toml"
    apart.parent.mkdir()
    apart.write_text(toml.read_text(encoding="utf-8"), encoding="utf-8")
    assert differences(original, description(copy_robot(apart, tmp_path / "other copy"))) == []


def test_what_only_looks_like_a_dependency_is_no_hindrance(tmp_path):
    toml = write_robot(tmp_path / "source")
    main = tmp_path / "source" / "xml" / "mine.xml"
    text = main.read_text().replace("<compiler meshdir", '<compiler strippath="true" meshdir', 1)
    main.write_text(text.replace('file="a.stl"', 'file="/nowhere/at/all/a.stl"', 1))
    original = description(toml)
    copy = copy_robot(toml, tmp_path / "copy")
    shutil.rmtree(tmp_path / "source")
    assert differences(original, description(copy)) == []


def test_a_file_that_is_no_robot_is_refused(tmp_path):
    (tmp_path / "mine.toml").write_text("name = 3")
    with pytest.raises(RobotError, match="there is no mjcf"):
        copy_robot(tmp_path / "mine.toml", tmp_path / "copy")

"""Self-contained copies of the files that describe a robot or a transporter."""

from __future__ import annotations

import json
import os
import shutil
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from torchrl_atr.envs.models.robot import RobotError
from torchrl_atr.envs.models.robot_file import read_robot

_DIRECTORIES = ("meshdir", "texturedir", "assetdir")
_XML = (".xml", ".mjcf", ".urdf")


def copy_robot(path: Path, folder: Path) -> Path:
    """Copy a robot's TOML file, its MJCF file, and all files that this includes or reads: meshes, textures and so on.

    The files keep their relative locations. Absolute paths in them become relative ones; nothing else is changed.

    Args:
        path: of the TOML file.
        folder: destination, empty or missing.

    Returns:
        The copy of the TOML file, somewhere below ``folder``.

    Raises:
        RobotError: if it is not a robot file, or reads a file that could not be copied.
        OSError: if a file cannot be read or written.
    """
    path = path.resolve()
    mjcf = read_robot(path).mjcf
    mjcf = mjcf.parent.resolve() / mjcf.name  # links to folders may be followed by ..
    files = dependencies(mjcf)
    root = Path(os.path.commonpath([file.parent for file in (path, *files)]))

    def copied(file: Path) -> Path:
        return folder / file.relative_to(root)

    for file in (path, *files):
        copied(file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copied(file))
    _point_to(copied(mjcf), copied(path))
    for file in files:
        if file.suffix.lower() in _XML:
            _make_relative(file, mjcf, copied, root)
    _check(copied(mjcf), [copied(file) for file in files], path)
    return copied(path)


def copy_transporter(path: Path, folder: Path) -> Path:
    """Copy a transporter's TOML file, which needs no other file; see :func:`copy_robot`."""
    folder.mkdir(parents=True, exist_ok=True)
    return Path(shutil.copyfile(path, folder / path.name))


COPIES: dict[str, Callable[[Path, Path], Path]] = {"robot": copy_robot, "transporter": copy_transporter}
"""Copy functions by the argument that may be given as a file."""


def dependencies(mjcf: Path) -> list[Path]:
    """List an MJCF file and all files that it includes or reads, absolute.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS
        >>> [file.name for file in dependencies(ROBOTS.get("a1").mjcf)]
        ['a1.xml']
    """
    named = mujoco.mju_getXMLDependencies(str(mjcf))
    if not all(map(os.path.isfile, named)):  # strippath: some named files are not read by the compiler
        model = mujoco.MjModel.from_xml_path(str(mjcf))
        named += [str(mjcf.parent / name.decode()) for name in bytes(model.paths).split(b"\0") if name]
    return sorted({Path(os.path.normpath(name)) for name in named if os.path.isfile(name)})


def _point_to(mjcf: Path, toml: Path) -> None:
    """Make a copy of a robot's TOML file name the copy of its MJCF file; a rewrite loses comments."""
    values = tomllib.loads(toml.read_text(encoding="utf-8-sig"))
    if os.path.normpath(toml.parent / values["mjcf"]) != str(mjcf):
        values["mjcf"] = os.path.relpath(mjcf, toml.parent)
        text = "".join(f"{name} = {json.dumps(value, ensure_ascii=False)}\n" for name, value in values.items())
        toml.write_text(text, encoding="utf-8")


def _make_relative(file: Path, main: Path, copied: Callable[[Path], Path], root: Path) -> None:
    """Rewrite the copy of an XML file if it holds absolute paths.

    Args:
        file: the original.
        main: the original of the model that it is part of.
        copied: from a file's path to that of its copy.
        root: the folder above all originals.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    try:
        tree = ElementTree.parse(file, parser)
    except ElementTree.ParseError:  # MuJoCo's parser is more lenient; the files that it reads are checked afterwards
        return
    absolute = [
        (element, name, value)
        for element in tree.iter()
        for name, value in element.attrib.items()
        if (name in _DIRECTORIES or name.startswith("file")) and os.path.isabs(value)
    ]
    if not absolute:
        return
    owner = file if file != main and tree.getroot().find("worldbody") is not None and _stands_alone(file) else main
    spec = mujoco.MjSpec.from_file(str(owner))
    place = copied(owner).parent
    for element, name, value in absolute:
        original = Path(os.path.normpath(value))
        target = copied(original) if original.is_relative_to(root) else original
        base = place
        if element.tag in ("include", "model"):
            base = copied(file).parent
        elif name not in _DIRECTORIES:
            given = Path(spec.texturedir if element.tag == "texture" else spec.meshdir)
            base = copied(Path(os.path.normpath(given))) if _below(given, root) else place / given
        element.set(name, os.path.relpath(target, os.path.normpath(base)))
    tree.write(copied(file), encoding="utf-8")


def _below(folder: Path, root: Path) -> bool:
    return folder.is_absolute() and Path(os.path.normpath(folder)).is_relative_to(root)


def _stands_alone(file: Path) -> bool:
    """Return whether an XML file is a model, which others attach, rather than a part that they include."""
    try:
        mujoco.MjSpec.from_file(str(file))
    except ValueError:
        return False
    return True


def _check(mjcf: Path, copies: Iterable[Path], source: Path) -> None:
    """Raise if a copy reads files that are not copies."""
    outside = sorted({str(file) for file in dependencies(mjcf)} - {str(file) for file in copies})
    if outside:
        raise RobotError(
            f"{source}: {mjcf.name} reads {outside[0]}, which could not be copied into the run; write it with a "
            "relative path"
        )

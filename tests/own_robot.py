"""A robot of one's own in files: a Go1 with a mesh, a texture and an included part, in folders of their own."""

from __future__ import annotations

import dataclasses
import json
import re
import struct
import zlib
from pathlib import Path

from torchrl_atr.envs import ROBOTS

GO1 = ROBOTS.get("go1")
FACTS = {field.name: getattr(GO1, field.name) for field in dataclasses.fields(GO1)}


def write_robot(folder: Path, absolute: str = "") -> Path:
    """Writes ``mine.toml``, ``xml/mine.xml``, ``xml/parts/more.xml``, ``assets/m/a.stl`` and ``assets/t/t.png``.

    Args:
        folder: absolute; may be missing.
        absolute: which references are absolute paths: any of ``"toml folders files include"``.

    Returns:
        The path of the TOML file.
    """
    mesh, texture = folder / "assets" / "m" / "a.stl", folder / "assets" / "t" / "t.png"
    for file, content in ((mesh, _stl(0.03)), (texture, _png())):
        file.parent.mkdir(parents=True)
        file.write_bytes(content)
    main, part = folder / "xml" / "mine.xml", folder / "xml" / "parts" / "more.xml"
    part.parent.mkdir(parents=True)
    folders = [
        str(file.parent) if "folders" in absolute else f"../assets/{file.parent.name}" for file in (mesh, texture)
    ]
    mesh_file, texture_file = (str(file) if "files" in absolute else file.name for file in (mesh, texture))
    part.write_text(
        f'<mujocoinclude><asset><mesh name="big" file="{mesh_file}" scale="2 2 2"/></asset></mujocoinclude>'
    )
    head = (
        f'<compiler meshdir="{folders[0]}" texturedir="{folders[1]}"/>'
        f'<include file="{part if "include" in absolute else "parts/more.xml"}"/>'
        f'<asset><mesh name="small" file="{mesh_file}"/><texture name="skin" type="2d" file="{texture_file}"/>'
        '<material name="skin" texture="skin"/></asset><worldbody>'
    )
    loads = '<geom type="mesh" mesh="small" mass="0.1" material="skin"/><geom type="mesh" mesh="big" mass="0.1"/>'
    text = GO1.mjcf.read_text().replace("<worldbody>", head, 1)
    start = text.index(">", text.index("<freejoint")) + 1
    main.write_text(text[:start] + loads + text[start:])
    facts = {**FACTS, "name": "mine", "mjcf": str(main) if "toml" in absolute else "xml/mine.xml"}
    toml = folder / "mine.toml"
    toml.write_text(
        "# mine\n"
        + "\n".join(f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in facts.items())
        + "\n"
    )
    return toml


def make_heavier(mjcf: Path) -> None:
    """Edits an MJCF file: the trunk weighs 9 kg."""
    before = mjcf.read_text()
    mjcf.write_text(re.sub(r'(<inertial [^>]*mass=)"[^"]*"', r'\1"9"', before, count=1))
    assert mjcf.read_text() != before


def _stl(size: float) -> bytes:
    """A tetrahedron."""
    corners = [(0.0, 0.0, 0.0), (size, 0.0, 0.0), (0.0, size, 0.0), (0.0, 0.0, size)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    data = bytes(80) + struct.pack("<I", len(faces))
    for face in faces:
        data += struct.pack("<12fH", 0.0, 0.0, 0.0, *(x for corner in face for x in corners[corner]), 0)
    return data


def _png() -> bytes:
    """Four red pixels by four."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0)
    rows = zlib.compress((b"\0" + b"\xff\0\0" * 4) * 4)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")

"""The wheel and the source distribution that users install: complete, small, and working where they are unpacked."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LARGEST = 25_000_000
"""Largest size of the wheel, bytes."""
BUILD = "from setuptools import build_meta; build_meta.build_sdist('dist'); build_meta.build_wheel('dist')"


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """Folder with a wheel and a source distribution, built from a copy: a build leaves files behind."""
    source = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    shutil.copytree(ROOT / "torchrl_atr", source / "torchrl_atr", ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run([sys.executable, "-c", BUILD], cwd=source, check=True, capture_output=True)
    return source / "dist"


def packaged() -> set[str]:
    """Return the files of the package, which a wheel must hold."""
    found = (file.relative_to(ROOT) for file in (ROOT / "torchrl_atr").rglob("*") if file.is_file())
    return {file.as_posix() for file in found if "__pycache__" not in file.parts and file.suffix != ".pyc"}


def test_the_wheel_holds_the_whole_package_and_nothing_else(dist):
    (wheel,) = dist.glob("*.whl")
    assert wheel.stat().st_size < LARGEST
    with zipfile.ZipFile(wheel) as file:
        names = {name for name in file.namelist() if ".dist-info/" not in name}
        entry = next(name for name in file.namelist() if name.endswith("entry_points.txt"))
        assert "torchrl-atr = torchrl_atr.cli:main" in file.read(entry).decode()
    assert names == packaged()


def test_the_source_distribution_builds_alone(dist):
    (archive,) = dist.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert packaged() | {"pyproject.toml", "README.md", "LICENSE"} <= names


def test_an_unpacked_wheel_works_without_the_clone(dist, tmp_path):
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        file.extractall(tmp_path / "site")
    code = f"""
import torchrl_atr
from torchrl_atr.cli import main
print(torchrl_atr.__file__)
assert main(["list", "robots"]) == main(["model", "a1", "single_board", "--output", {str(tmp_path / "a1.xml")!r}]) == 0
"""
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    told = done.stdout.decode()
    assert told.startswith(str(tmp_path / "site"))
    for robot in ("a1", "go1", "anymal_c", "spot"):
        assert robot in told
    assert (tmp_path / "a1.xml").is_file()

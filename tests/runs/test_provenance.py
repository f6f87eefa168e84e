"""Provenance: the commit of the clone beside every figure, and what it took."""

from __future__ import annotations

import subprocess
from functools import partial

import pytest

import torchrl_atr
from torchrl_atr.config import make_config
from torchrl_atr.runs import provenance


@pytest.fixture
def package(tmp_path, monkeypatch):
    """The package as if it were in a folder that is not under version control."""
    monkeypatch.setattr(torchrl_atr, "__file__", str(tmp_path / "torchrl_atr" / "__init__.py"))
    monkeypatch.setattr(provenance, "_commit", provenance._commit.__wrapped__)  # without its cache
    return tmp_path


def test_an_installed_package_has_no_commit(package):
    assert "commit" not in provenance.machine()["versions"]


def test_a_clone_has_its_commit_and_a_mark_if_files_were_changed(package):
    git = partial(subprocess.run, cwd=package, check=True, capture_output=True, text=True)
    file, who = package / "file", ["-c", "user.name=A", "-c", "user.email=a@b.c"]
    file.write_text("one")
    git(["git", "init"])
    git(["git", "add", "file"])
    git(["git", *who, "commit", "-m", "one"])
    head = git(["git", "rev-parse", "HEAD"]).stdout.strip()
    assert provenance.machine()["versions"]["commit"] == head[:12]
    file.write_text("two")
    assert provenance.machine()["versions"]["commit"] == f"{head[:12]}+"


@pytest.mark.parametrize(("seconds", "minutes"), [(120.0, 2.0), (90.0, 1.5), (1.0, 0.02)])
def test_seconds_are_told_in_minutes(tmp_path, seconds, minutes):
    assert provenance.provenance(make_config(), tmp_path, None, 0, seconds)["minutes"] == minutes

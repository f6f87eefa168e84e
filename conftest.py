"""Tests that need dm_control are skipped where it is not installed, or kept out by ``--without dm_control``."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from torchrl_atr._errors import MissingPackageError

_ON_DM_CONTROL = ("torchrl_atr/envs/suite.py", "torchrl_atr/envs/physics/dmc.py", "tests/envs/test_suite.py")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--without", action="append", default=[], metavar="PACKAGE", help="as if it were not installed")


def pytest_configure(config: pytest.Config) -> None:
    for package in config.getoption("--without"):
        sys.modules[package] = None  # type: ignore[assignment]  # an import raises ModuleNotFoundError


def _lacks_dm_control() -> bool:
    try:
        importlib.import_module("dm_control")
    except ImportError:
        return True
    return False


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    if collection_path.as_posix().endswith(_ON_DM_CONTROL) and _lacks_dm_control():
        return True
    return None


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call() -> Iterator[None]:
    try:
        return (yield)
    except MissingPackageError as error:
        if not _lacks_dm_control():
            raise
        pytest.skip(str(error))

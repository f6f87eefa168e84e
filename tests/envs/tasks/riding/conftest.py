"""A transporter of a user's own."""

from __future__ import annotations

import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

from torchrl_atr.envs.models import TRANSPORTER_DESIGNS, TRANSPORTERS


@pytest.fixture
def skateboard(monkeypatch):
    """What ``examples/skateboard.py`` defines; what it registers is gone after the test."""
    for registry in (TRANSPORTER_DESIGNS, TRANSPORTERS):
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    return SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[4] / "examples" / "skateboard.py")))

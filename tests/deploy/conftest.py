"""A bundle of the committed policy, exported once for all workers, and copies of it to spoil."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from torchrl_atr.deploy.manifest import MANIFEST, seal

RUN = Path(__file__).parents[2] / "results" / "a1-single_board"


@pytest.fixture(scope="session")
def bundle(tmp_path_factory, worker_id) -> Path:
    """The bundle ``a1-single_board``; only to be read."""
    from torchrl_atr.deploy.export import export_run

    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "bundles" / "a1-single_board"
    folder.parent.mkdir(exist_ok=True)
    with FileLock(folder.with_suffix(".lock")):
        if not folder.exists():
            export_run(RUN, folder)
    return folder


@pytest.fixture
def copied(bundle, tmp_path) -> Path:
    """A copy of the bundle."""
    return Path(shutil.copytree(bundle, tmp_path / "a1-single_board"))


@pytest.fixture
def rewritten(copied) -> Callable[..., Path]:
    """``rewritten(change)``: a copy whose manifest was changed by ``change(manifest)``, and sealed again."""

    def rewrite(change: Callable[[dict[str, Any]], Any]) -> Path:
        manifest = json.loads((copied / MANIFEST).read_text())
        change(manifest)
        (copied / MANIFEST).write_text(json.dumps(seal(manifest)))
        return copied

    return rewrite

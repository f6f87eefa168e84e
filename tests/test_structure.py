"""How the package is built: short files, imports that point down, no cycles, a core that names no task."""

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest

import torchrl_atr

PACKAGE = Path(torchrl_atr.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
LAYERS = [  # each may import from those before it, and from what is in none
    ("torchrl_atr.envs.interpretation", "torchrl_atr.envs.specs"),
    ("torchrl_atr.envs.models",),
    ("torchrl_atr.envs.physics",),
    ("torchrl_atr.envs.transforms.grid",),
    ("torchrl_atr.envs.tasks",),
    ("torchrl_atr.envs.transforms",),
    ("torchrl_atr.envs.env", "torchrl_atr.envs.recorder", "torchrl_atr.envs.suite"),
    ("torchrl_atr.envs",),
    ("torchrl_atr.modules", "torchrl_atr.objectives"),
    ("torchrl_atr.evaluation",),
    ("torchrl_atr.deploy.manifest", "torchrl_atr.deploy.weights"),
    ("torchrl_atr.navigation",),
    ("torchrl_atr.config",),
    ("torchrl_atr.runs",),
    ("torchrl_atr.training",),
    ("torchrl_atr.comparison",),
    ("torchrl_atr.deploy",),
    ("torchrl_atr.reproduction",),
    ("torchrl_atr.viewer",),
    ("torchrl_atr.cli",),
]


def name_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports(path: Path) -> frozenset[str]:
    """Modules of the package that a file imports when it is imported itself."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found.add(whole if node.module.startswith("torchrl_atr") and is_module(whole) else node.module)
    return frozenset(name for name in found if name.startswith("torchrl_atr"))


@cache
def is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def layer(name: str) -> int | None:
    fits = [(len(p), i) for i, prefixes in enumerate(LAYERS) for p in prefixes if f"{name}.".startswith(f"{p}.")]
    return max(fits)[1] if fits else None


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_files_are_short(path):
    assert len(path.read_text().splitlines()) <= 300


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_imports_point_down(path):
    own = layer(name_of(path))
    if own is not None:
        upward = [name for name in imports(path) if (other := layer(name)) is not None and other > own]
        assert not upward


def test_networks_and_losses_know_no_env():
    for folder in ("modules", "objectives"):
        for path in (PACKAGE / folder).rglob("*.py"):
            assert "torchrl_atr.envs" not in {".".join(name.split(".")[:2]) for name in imports(path)}, path


def test_there_is_no_import_cycle():
    graph = {name_of(path): imports(path) & {name_of(each) for each in FILES} for path in FILES}
    open_, done = [], set()

    def visit(name: str) -> None:
        assert name not in open_, " -> ".join([*open_[open_.index(name) :], name])
        if name not in done:
            open_.append(name)
            for other in sorted(graph[name]):
                visit(other)
            done.add(open_.pop())

    for name in graph:
        visit(name)


def test_the_core_and_riding_do_not_name_walking():
    listing = {"torchrl_atr.envs.tasks", "torchrl_atr.envs.tasks.registry", "torchrl_atr.envs"}
    for path in (PACKAGE / "envs").rglob("*.py"):
        if name_of(path) not in listing and "walking" not in path.parts:
            code = ast.unparse(ast.parse(path.read_text()))
            names = {node.id for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)}
            assert not any("walking" in name.lower() for name in {*names, *imports(path)}), path


def test_only_the_command_line_imports_the_viewer_and_its_libraries_wait_until_a_page_is_served():
    for path in FILES:
        name = name_of(path)
        inside = any(f"{name}.".startswith(f"{own}.") for own in ("torchrl_atr.viewer", "torchrl_atr.cli.view"))
        tree = ast.parse(path.read_text())
        assert inside or not any(f"{each}.".startswith("torchrl_atr.viewer.") for each in modules(ast.walk(tree))), path
        assert not {each.partition(".")[0] for each in modules(tree.body)} & {"viser", "mjviser"}, path
    assert not any(name.startswith("torchrl_atr.viewer") for name in imports(PACKAGE / "cli" / "view.py"))


def modules(nodes: Iterable[ast.AST]) -> set[str]:
    """Modules that import statements name."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
    return found

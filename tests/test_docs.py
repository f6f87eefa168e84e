"""The documentation is true: code runs, commands parse, links lead somewhere, the site builds without a warning."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import torchrl_atr
from torchrl_atr._errors import MissingPackageError
from torchrl_atr._settings import settings
from torchrl_atr.cli.parser import build_parser
from torchrl_atr.cli.train_options import parse_train
from torchrl_atr.training import TrainConfig

ROOT = Path(__file__).parents[1]
DOCS = sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS]
BLOCK = re.compile(
    r"^(?:<!-- not run: (?P<reason>[^\n]+) -->\n\n?)?```(?P<kind>[^\n]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)
RESULTS = re.compile(r"<!-- results:begin -->.*?<!-- results:end -->", re.DOTALL)
"""Commands of runs that were trained by earlier versions."""


class Block(NamedTuple):
    """Block of code of a page: its language, text and first line, and why it is not run, if it is not."""

    kind: str
    text: str
    line: int
    reason: str | None


def blocks(path: Path, kind: str) -> list[Block]:
    text = path.read_text(encoding="utf-8")
    found = (
        Block(each["kind"], each["text"], text.count("\n", 0, each.start("text")), each["reason"])
        for each in BLOCK.finditer(text)
    )
    return [each for each in found if each.kind == kind]


REGISTERED = {
    name
    for page in PAGES
    for block in blocks(page, "python")
    for name in re.findall(r'register(?:_\w+)?\(\s*"([^"]+)"', block.text)
}
"""Names of tasks, robots, transporters and estimators that pages register."""


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def with_blocks(kind: str) -> list[Path]:
    return [path for path in PAGES if blocks(path, kind)]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the committed policy as ``runs/ride``; registries stay as they were.

    Names that a page registers are free, whatever other tests of this process have left.
    """
    from torchrl_atr.envs.models import ROBOTS, TRANSPORTER_DESIGNS, TRANSPORTERS
    from torchrl_atr.envs.tasks import TASKS
    from torchrl_atr.modules.estimators import _ESTIMATORS

    for registry in (ROBOTS, TRANSPORTERS, TRANSPORTER_DESIGNS, TASKS, _ESTIMATORS):
        kept = {name: entry for name, entry in registry._entries.items() if name not in REGISTERED}
        monkeypatch.setattr(registry, "_entries", kept)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "ride").symlink_to(ROOT / "results" / "a1-single_board")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", with_blocks("python"), ids=name_of)
def test_python_blocks_run_in_order(page, place, monkeypatch):
    namespace: dict[str, object] = {"__name__": "page"}
    monkeypatch.setitem(sys.modules, "page", type(sys)("page"))  # where a class of a block looks itself up
    for block in blocks(page, "python"):
        code = "\n" * block.line + block.text
        compiled = compile(code, str(page), "exec")  # what is not run is at least Python
        if block.reason is None:
            exec(compiled, namespace)


def commands(text: str) -> Iterator[list[str]]:
    """Yield the words after ``torchrl-atr`` of every command in a block of shell."""
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        while words:
            length = words.index("&&") if "&&" in words else len(words)
            command, words = words[:length], words[length + 1 :]
            names = [Path(word).name for word in command]
            if "torchrl-atr" in names:
                yield command[names.index("torchrl-atr") + 1 :]


def parse(words: list[str]) -> None:
    if words[0] == "train":
        parse_train(words[1:])
    else:
        _, unknown = build_parser().parse_known_args(words)
        assert not unknown, f"unknown {unknown}"


@pytest.mark.parametrize("page", with_blocks("bash"), ids=name_of)
def test_commands_in_shell_blocks_parse(page, place):
    for block in blocks(page, "bash"):
        for words in commands(block.text):
            parse(words)


def test_commands_in_the_text_exist():
    """Those in running text may leave arguments out: their command and the names of their options are checked."""
    parser = build_parser()
    (choices,) = (action.choices for action in parser._actions if action.dest == "command")
    for page in PAGES:
        text = RESULTS.sub("", page.read_text(encoding="utf-8"))
        for span in re.findall(r"(?<!`)`torchrl-atr ([^`\n]+)`(?!`)", text):
            command, *words = shlex.split(span)
            assert command in choices, (page, span)
            options = {option for action in choices[command]._actions for option in action.option_strings}
            if command == "train":
                if not set(words) & {"--help", "..."}:
                    parse_train(words)
            else:
                assert {word for word in words if word.startswith("--")} <= options, (page, span)


def test_settings_in_the_text_exist():
    known = set(settings(TrainConfig))
    named = re.compile(r"`((?:ppo|roa|estimator|exploration|compute|logging)\.[a-z_]+)(?:=[^`]*)?`")
    for page in PAGES:
        assert {*named.findall(page.read_text(encoding="utf-8"))} <= known, page


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=name_of)
def test_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        path = target.partition("#")[0]
        if path and "://" not in path:
            assert (page.parent / path).exists(), target


def resolve(path: str) -> bool:
    """Return whether a dotted name is a module, or what is in one; so it is if its module needs an extra."""
    parts = path.split(".")
    for length in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:length]))
        except MissingPackageError:
            return True
        except ImportError:
            continue
        for part in parts[length:]:
            if dataclasses.is_dataclass(thing) and part in {field.name for field in dataclasses.fields(thing)}:
                return True
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def test_references_in_docstrings_exist():
    role = re.compile(r":(?:class|func|meth|attr|data|mod|exc):`~?(torchrl_atr[\w.]*)`")
    package = Path(torchrl_atr.__file__).parent
    names = {name for path in package.rglob("*.py") for name in role.findall(path.read_text(encoding="utf-8"))}
    assert len(names) > 50
    assert not [name for name in sorted(names) if not resolve(name)]


def test_the_api_lists_every_package():
    found = {each.name for each in pkgutil.walk_packages(torchrl_atr.__path__, "torchrl_atr.") if each.ispkg}
    listed = re.findall(r"^   (torchrl_atr[\w.]*)$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE)
    public = {name for name in found if hasattr(importlib.import_module(name), "__all__")}
    assert sorted(listed) == sorted({"torchrl_atr", *public})


@pytest.mark.parametrize("notebook", sorted((ROOT / "docs" / "notebooks").glob("*.md")), ids=name_of)
def test_notebooks_run(notebook, place):
    """In this process: the site's own build does it in two kernels, which import torch once more each."""
    pytest.importorskip("IPython")
    matplotlib = pytest.importorskip("matplotlib")
    namespace: dict[str, object] = {"__name__": "notebook"}
    with matplotlib.rc_context({"figure.max_open_warning": 0}):
        for cell in blocks(notebook, "{code-cell} ipython3"):
            code = "\n".join("" if line.startswith("%") else line for line in cell.text.splitlines())
            exec(compile("\n" * cell.line + code, str(notebook), "exec"), namespace)
        matplotlib.pyplot.close("all")


def test_the_site_builds_without_a_warning(tmp_path):
    """In a copy, as autosummary writes pages beside those that it reads; notebooks are run above."""
    pytest.importorskip("myst_nb")
    for path in ROOT.iterdir():
        if path.name != "docs" and not path.name.startswith("."):
            (tmp_path / path.name).symlink_to(path)
    shutil.copytree(ROOT / "docs", tmp_path / "docs", ignore=shutil.ignore_patterns("_build", "api", "__pycache__"))
    options = ["-W", "--keep-going", "-q", "-b", "html", "-D", "nb_execution_mode=off"]
    command = [sys.executable, "-m", "sphinx", *options, "docs", "site"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr[-4000:]
    for page in ("index", "task", "notebooks/turn", "api/torchrl_atr.envs"):
        assert (tmp_path / "site" / f"{page}.html").is_file()
    assert "QuadrupedEnv" in (tmp_path / "site" / "api" / "torchrl_atr.envs.html").read_text(encoding="utf-8")

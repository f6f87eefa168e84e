"""A run remembers the modules that it needs, and says so where one is missing."""

from __future__ import annotations

import sys

import pytest

from torchrl_atr.cli import main
from torchrl_atr.envs import ROBOTS, TRANSPORTERS
from torchrl_atr.modules.estimators import _ESTIMATORS
from torchrl_atr.training import load_checkpoint, load_run

pytestmark = pytest.mark.usefixtures("undrawn")

TINY = ["--num-envs", "2", "--ppo.rollout-steps", "2", "--ppo.minibatches", "1", "--compute.num-threads", "1"]
GRID = ["--max-speed", "0", "--max-yaw-rate", "0", "--robots-per-command", "1"]
MINE = """
from dataclasses import replace
from torchrl_atr.envs import ROBOTS, TRANSPORTERS
from torchrl_atr.modules import MLPEstimator, register_estimator

ROBOTS.register("mine", replace(ROBOTS.get("a1"), name="mine", kp=45.0))
register_estimator("mine", MLPEstimator)
"""
DECKS = """
from dataclasses import replace
from torchrl_atr.envs import TRANSPORTERS

TRANSPORTERS.register("wide", replace(TRANSPORTERS.get("single_board_g1"), name="wide", size=(0.9, 0.9, 0.05)))
"""


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """What a test registers and imports is forgotten; a call inside it forgets like another process."""
    known = [(registry, dict(registry._entries)) for registry in (ROBOTS, TRANSPORTERS, _ESTIMATORS)]
    modules, path = set(sys.modules), list(sys.path)

    def forget():
        for registry, entries in known:
            registry._entries = dict(entries)
        for name in set(sys.modules) - modules:
            if name.startswith("my_"):
                del sys.modules[name]
        sys.path[:] = path

    yield forget
    forget()


@pytest.fixture
def run(tmp_path, monkeypatch, fresh):
    """A run that needs ``my_robots``, with nothing imported any more."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_robots.py").write_text(MINE)
    options = ["--import", "my_robots", "--robot", "mine", "--estimator", "mine", "--total-frames", "8"]
    assert main(["train", *TINY, *options, "--output", "run"]) == 0
    fresh()
    return tmp_path / "run"


def test_it_is_evaluated_without_naming_them(run):
    assert main(["evaluate", str(run), *GRID]) == 0


@pytest.mark.parametrize("command", ["evaluate", "play", "train --resume", "train --output new --from"])
def test_one_that_is_missing_is_named_with_the_run_and_the_remedy(run, tmp_path, capsys, command):
    (tmp_path / "my_robots.py").rename(tmp_path / "my_moved.py")
    assert main([*command.split(), str(run)]) == 2
    message = capsys.readouterr().err
    assert f"the settings of {run} do not work here: cannot import 'my_robots'" in message
    assert "--import" in message
    assert len(message.strip().splitlines()) <= 3
    assert not (tmp_path / "new").exists()


def test_another_module_takes_its_place(run, tmp_path, fresh):
    (tmp_path / "my_robots.py").rename(tmp_path / "my_moved.py")
    moved = ["--import", "my_moved"]
    assert main(["evaluate", str(run), *moved, *GRID]) == 0
    fresh()
    assert main(["train", "--from", str(run), *moved, "--output", "new"]) == 0
    fresh()
    assert main(["train", "--resume", str(run), *moved, "--total-frames", "16"]) == 0
    for folder in (run, tmp_path / "new"):
        assert load_checkpoint(folder)["config"]["imports"] == ["my_moved"]
        fresh()
        assert load_run(folder, num_envs=1)[0].task.robot == "mine"


def test_one_more_module_adds_to_those_that_it_remembers(run, tmp_path):
    (tmp_path / "my_decks.py").write_text(DECKS)
    other = ["--import", "my_decks", "--transporter", "wide", "--output", "report"]
    assert main(["evaluate", str(run), *other, *GRID]) == 0


def test_a_dump_of_a_run_finds_the_runs_modules(run, tmp_path, fresh, capsys):
    _, env, _, _ = load_run(run, num_envs=2, dump_dir=run / "diverged")
    env.rollout(2)
    env.base_env._recorder.dump(0, "a test")
    fresh()
    (dump,) = (run / "diverged").iterdir()
    assert main(["replay", str(dump)]) == 0
    fresh()
    alone = dump.rename(tmp_path / dump.name)
    assert main(["replay", str(alone)]) == 2
    assert "unknown robot 'mine'" in (message := capsys.readouterr().err)
    assert "--import" in message
    fresh()
    assert main(["replay", str(alone), "--import", "my_robots"]) == 0

"""Whatever a command does, a signal ends it with one line and an exit code that shells expect, and nothing is left."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from torchrl_atr import _interrupt
from torchrl_atr._files import atomic, folder_for, whole
from torchrl_atr._interrupt import Interrupt, Stopped, signals_held
from torchrl_atr.cli import commands, main
from torchrl_atr.evaluation import ReplayedStep
from torchrl_atr.training import Trainer, make_config

TINY = {
    "env.num_envs": 2,
    "ppo.rollout_steps": 2,
    "total_frames": 8,
    "compute.num_threads": 1,
    "ppo.minibatches": 1,
    "ppo.critic_cells": [8],
}
PATIENCE = 120.0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    Trainer(make_config(TINY), folder).save()
    return folder


def _wait_for(sign, process):
    deadline = time.monotonic() + PATIENCE
    while not sign():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.02)


def _group(pgid):
    """Living processes of a group."""
    listing = subprocess.run(["ps", "-eo", "pgid=,stat=,args="], capture_output=True, encoding="utf-8").stdout
    rows = [line.split(None, 2) for line in listing.splitlines()]
    return [row for row in rows if row[0] == str(pgid) and not row[1].startswith("Z")]


def _interrupted(words, number, group, sign, **environment):
    """Starts a command in a group of its own, and sends the signal once there is a sign of its work."""
    process = subprocess.Popen(
        [sys.executable, "-m", "torchrl_atr.cli", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # not what a script's & sets
        env={**os.environ, **environment},
    )
    try:
        _wait_for(sign, process)
        (os.killpg if group else os.kill)(process.pid, number)
        _, errors = process.communicate(timeout=PATIENCE)
        assert _group(process.pid) == []
    finally:
        process.kill()
    return process.returncode, errors


KINDS = pytest.mark.parametrize(("number", "group"), [(signal.SIGINT, True), (signal.SIGTERM, False)])


@KINDS
def test_a_video_that_is_stopped_leaves_nothing(run, tmp_path, number, group):
    pytest.importorskip("mediapy")
    _needs_renderer()
    video = tmp_path / "new" / "ride.mp4"
    begun = lambda: any(video.parent.glob(".ride.*.part.mp4"))  # noqa: E731
    words = ["play", run, "--video", video, "--seconds", 3600]
    assert _interrupted(words, number, group, begun) == (128 + number, "stopped\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", ["mp4", "gif"])
def test_a_replay_that_is_stopped_between_two_steps_leaves_nothing(tmp_path, monkeypatch, capsys, suffix):
    pytest.importorskip("mediapy")
    module = sys.modules[ReplayedStep.__module__]
    steps = [ReplayedStep(i, 0.0, 0.0, 0.0, 0.0, 0.0, False) for i in range(5)]
    monkeypatch.setattr(module, "load_dump", lambda path: {"reason": ""})
    monkeypatch.setattr(module, "_make_env", lambda *_: None)
    monkeypatch.setattr(module, "_steps", lambda *_: iter(steps))
    monkeypatch.setattr(module, "OffscreenRenderer", _Blank)

    def line(step):
        if step.step == 3:
            assert any(tmp_path.rglob(f".ride.*.part.{suffix}"))
            assert _children("ffmpeg")
            signal.raise_signal(signal.SIGTERM)
        return str(step)

    monkeypatch.setattr(commands, "replay_line", line)
    assert main(["replay", "dump.pt", "--video", str(tmp_path / "new" / f"ride.{suffix}")]) == 143
    assert capsys.readouterr().err == "stopped\n"
    assert list(tmp_path.iterdir()) == []
    assert _children("ffmpeg") == []


class _Blank:
    """Stands in for a renderer, which not every machine has."""

    def __init__(self, *arguments: object) -> None: ...

    def __enter__(self):
        return self

    def __exit__(self, *exception: object) -> None: ...

    def render(self, *arguments: object, **options: object):
        return np.zeros((480, 640, 3), np.uint8)


def _children(name):
    listing = subprocess.run(["ps", "-eo", "ppid=,stat=,args="], capture_output=True, encoding="utf-8").stdout
    rows = [line.split(None, 2) for line in listing.splitlines()]
    return [row for row in rows if row[0] == str(os.getpid()) and name in row[2] and not row[1].startswith("Z")]


def _needs_renderer():
    from torchrl_atr.envs import RidingEnv
    from torchrl_atr.evaluation.rendering import DisplayError, OffscreenRenderer

    try:
        OffscreenRenderer(RidingEnv(num_envs=1, seed=0)).close()
    except DisplayError as error:
        pytest.skip(str(error))


@KINDS
def test_an_evaluation_that_is_stopped_leaves_nothing(run, tmp_path, number, group):
    report, scratch = tmp_path / "reports" / "one", tmp_path / "scratch"
    scratch.mkdir()
    before = sorted(run.iterdir())
    words = ["evaluate", run, "--output", report, "--robots-per-command", 1000]
    assert _interrupted(words, number, group, report.is_dir, TMPDIR=str(scratch)) == (128 + number, "stopped\n")
    assert [path.name for path in tmp_path.iterdir()] == ["scratch"]
    assert sorted(run.iterdir()) == before


def test_a_benchmark_that_is_stopped_leaves_nothing(tmp_path):
    """While its first child, which measures memory, is at work; the child has the terminal's Ctrl-C, too."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    words = ["bench", "--quick", "--output", tmp_path / "bench"]
    code, errors = _interrupted(words, signal.SIGINT, True, lambda: any(scratch.iterdir()), TMPDIR=str(scratch))
    assert (code, errors) == (130, "stopped\n")
    assert [path.name for path in tmp_path.iterdir()] == ["scratch"]
    assert [path for path in scratch.iterdir() if "inductor" not in path.name] == []


def test_a_signal_during_the_imports_is_met(tmp_path):
    """As soon as the process has its handlers: a list that takes seconds to import what it shows."""
    pid = tmp_path / "pid"
    code = (
        "import os, sys, pathlib, torchrl_atr._interrupt as i\n"
        "enter = i.Interrupt.__enter__\n"
        f"i.Interrupt.__enter__ = lambda self: (enter(self), pathlib.Path({str(pid)!r}).touch())[0]\n"
        "sys.argv = ['torchrl-atr', 'list', 'settings']\n"
        "from torchrl_atr.cli import main\n"
        "sys.exit(main())"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    _wait_for(pid.exists, process)
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=PATIENCE) == (b"", b"stopped\n")
    assert process.returncode == 143


SWALLOWS = """
import signal, time
for _ in range({times}):
    try:
        signal.raise_signal(signal.{name})
    except BaseException:
        time.sleep(0.1)
over = True
"""


def test_a_signal_while_an_import_lock_is_collected_stops_the_import_afterwards(untraced):
    """Python ignores and prints what such a callback raises."""
    done, source = [], "def cb():\n    signal.raise_signal(signal.SIGTERM)\n    done.append('cb')\n"
    names = {"signal": signal, "done": done}
    exec(compile(source, "<frozen importlib._bootstrap>", "exec"), names)

    def imports():
        with Interrupt():
            names["cb"]()
            done.append("the import")

    with pytest.raises(Stopped):
        imports()
    assert done == ["cb"]


def _import(name):
    importlib.import_module(name)
    time.sleep(5.0)


@pytest.fixture
def untraced():
    """Without a debugger or a measurement of coverage, whose trace function would stay."""
    before = sys.gettrace()
    sys.settrace(None)
    yield
    assert sys.gettrace() is None
    sys.settrace(before)


@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_module_that_takes_signals_for_missing_parts_of_its_own_does_not_keep_them(
    monkeypatch, tmp_path, untraced, name, times
):
    module = f"swallows_{name}_{times}"
    (tmp_path / f"{module}.py").write_text(SWALLOWS.format(name=name, times=times), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(_interrupt, "_REPEAT", 0.05)
    started = time.monotonic()
    with pytest.raises(Stopped) as stop, Interrupt():
        _import(module)
    assert stop.value.signal == getattr(signal, name)
    assert time.monotonic() - started < 4.0
    assert sys.modules[module].over


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("error", [BrokenPipeError(32, "Broken pipe"), ImportError("half"), RuntimeError("gone")])
def test_what_a_signal_did_to_others_is_no_error_of_its_own(monkeypatch, capsys, number, error):
    def command(arguments):
        try:
            signal.raise_signal(number)
        except KeyboardInterrupt:
            raise error from None

    monkeypatch.setitem(commands.COMMANDS, "list", command)
    assert main(["list", "robots"]) == 128 + number
    assert capsys.readouterr().err == "stopped\n"


def test_the_same_error_without_a_signal_stays_one(monkeypatch, capsys):
    def command(arguments):
        raise BrokenPipeError(32, "Broken pipe", "ffmpeg")

    monkeypatch.setitem(commands.COMMANDS, "list", command)
    assert main(["list", "robots"]) == 2
    assert "ffmpeg: Broken pipe" in capsys.readouterr().err


def test_signals_that_follow_at_once_are_one_request(monkeypatch):
    """As of timeout(1), which signals the process and then its group; later ones are another request."""
    notes = []
    with Interrupt(lambda: notes.append("noted")) as interrupt:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        assert notes == ["noted"]
        monkeypatch.setattr(_interrupt, "_REPEAT", 0.0)
        with pytest.raises(Stopped) as stop:
            signal.raise_signal(signal.SIGINT)
    assert stop.value.signal == signal.SIGINT
    assert interrupt.signal == signal.SIGTERM


def test_cleaning_up_is_not_interrupted_by_a_repetition():
    cleaned = []

    def work():
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGTERM)
            cleaned.append(True)

    with Interrupt(), pytest.raises(Stopped):
        work()
    assert cleaned == [True]


def test_handlers_come_back():
    before = [signal.getsignal(number) for number in _interrupt.SIGNALS]
    with Interrupt(), Interrupt(lambda: None):
        assert signal.getsignal(signal.SIGTERM) not in before
    assert [signal.getsignal(number) for number in _interrupt.SIGNALS] == before


def test_children_are_started_with_signals_blocked():
    with signals_held():
        child = subprocess.Popen(["sleep", "60"])
    try:
        status = Path(f"/proc/{child.pid}/status").read_text(encoding="utf-8")
        blocked = int(next(line for line in status.splitlines() if line.startswith("SigBlk")).split()[1], 16)
        assert all(blocked >> number - 1 & 1 for number in _interrupt.SIGNALS)
    finally:
        child.kill()
        child.wait()
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, []) & set(_interrupt.SIGNALS)


@pytest.mark.parametrize("writer", [lambda path: atomic(path / "x.txt"), folder_for, whole])
def test_a_stopped_writer_removes_what_it_made_and_keeps_what_was_there(tmp_path, writer):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "x.txt").write_text("old", encoding="utf-8")

    def write(folder):
        with writer(folder) as path:
            if path.is_dir() and path != folder:
                (path / "x.txt").write_text("half", encoding="utf-8")
            raise KeyboardInterrupt

    for folder in (tmp_path / "new" / "deep", tmp_path / "old"):
        with pytest.raises(KeyboardInterrupt):
            write(folder)
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == ["old", "old/x.txt"]
    assert (tmp_path / "old" / "x.txt").read_text(encoding="utf-8") == "old"


def test_a_report_that_is_being_moved_is_moved(tmp_path, monkeypatch):
    """Files of two reports would be worse than an end that comes late."""
    from torchrl_atr import _files

    replace, moved = os.replace, []

    def interrupted(source, target):
        replace(source, target)
        moved.append(target)
        if len(moved) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(_files.os, "replace", interrupted)
    report = whole(tmp_path / "report")
    folder = report.__enter__()
    for name in "ab":
        (folder / name).write_text(name, encoding="utf-8")
    with pytest.raises(KeyboardInterrupt):
        report.__exit__(None, None, None)
    assert sorted(path.name for path in (tmp_path / "report").iterdir()) == ["a", "b"]

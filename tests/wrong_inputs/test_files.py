"""What a file system can refuse: it is said before work is lost, and what was there stays."""

from __future__ import annotations

import errno
import os
import resource

import pytest

from torchrl_atr._files import explain
from torchrl_atr.cli import main
from torchrl_atr.training import load_checkpoint, save_checkpoint

GRID = ["--max-speed", "0", "--max-yaw-rate", "0", "--robots-per-command", "1"]


def _failing(number: int, function, calls: int = 0):
    """``function``, which fails with an error of the operating system after some calls."""
    left = [calls]

    def call(*arguments, **options):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(number, os.strerror(number))
        return function(*arguments, **options)

    return call


@pytest.fixture
def folder(tmp_path):
    """A folder with a file in it, and a folder named as files are."""
    (tmp_path / "note.txt").write_text("keep me")
    (tmp_path / "scene.xml").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "culprit", "remedy"),
    [
        ("train --output HERE/note.txt", "note.txt: File exists", "choose another path"),
        ("train --output HERE/note.txt/run", "note.txt/run: Not a directory", "choose another path"),
        (f"train --output HERE/{'x' * 300}", "File name too long", "choose a shorter name"),
        ("train --config HERE", "/", "use a .toml or .json file"),
        ("evaluate RUN --output HERE/note.txt", "note.txt: File exists", "choose another path"),
        ("model a1 single_board --output HERE/scene.xml", "scene.xml: not a file", "choose another path"),
        ("model a1 single_board --output HERE/note.txt/a1.xml", "note.txt: File exists", "choose another path"),
        ("play RUN --video HERE/note.txt/ride.mp4", "note.txt: File exists", "choose another path"),
        ("train --resume HERE/note.txt", "note.txt is a file", "give the folder of a run"),
        ("evaluate RUN/checkpoint.pt", "checkpoint.pt is a file", "give the folder of a run"),
    ],
)
def test_what_is_in_the_way_is_named(refused, folder, monkeypatch, untouched_run, arguments, culprit, remedy):
    pytest.importorskip("mediapy")
    monkeypatch.setattr("torchrl_atr.evaluation.evaluate_tracking", None)  # it must not come to that
    monkeypatch.setattr("torchrl_atr.evaluation.video.OffscreenRenderer", _NoRenderer)
    words = [word.replace("RUN", str(untouched_run)).replace("HERE", str(folder)) for word in arguments.split()]
    refused(words, culprit, remedy)
    assert (folder / "note.txt").read_text() == "keep me"
    assert sorted(file.name for file in folder.iterdir()) == ["note.txt", "scene.xml"]


class _NoRenderer:
    """Stands in for a renderer, which not every machine has."""

    def __init__(self, *arguments: object) -> None: ...

    def __enter__(self):
        return self

    def __exit__(self, *exception: object) -> None: ...


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS])
def test_a_read_only_folder_is_refused_before_the_evaluation(refused, tmp_path, monkeypatch, untouched_run, number):
    monkeypatch.setattr("torchrl_atr.evaluation.evaluate_tracking", None)
    monkeypatch.setattr("torchrl_atr._files.tempfile.TemporaryFile", _failing(number, None))
    reason = os.strerror(number)
    refused(["evaluate", untouched_run, "--output", tmp_path], f"{tmp_path}: {reason}", "that you may write to")


def test_a_read_only_run_folder_is_refused_before_the_training(refused, tmp_path, monkeypatch, tiny):
    monkeypatch.setattr("torchrl_atr._files.Path.touch", _failing(errno.EROFS, None))
    run = tmp_path / "run"
    refused(["train", *tiny, "--output", run], f"{run / 'config.toml'}: Read-only", "that you may write to")


def test_a_full_disk_is_named_before_the_training(refused, tmp_path, monkeypatch, tiny):
    monkeypatch.setattr(os, "fsync", _failing(errno.ENOSPC, None))
    run = tmp_path / "run"
    refused(["train", *tiny, "--output", run], f"{run / 'checkpoint.pt'}: No space left", "free some space")
    assert not (run / "progress.csv").exists()


def test_a_disk_that_fills_up_leaves_the_last_checkpoint(refused, tmp_path, monkeypatch, tiny):
    monkeypatch.setattr(os, "fsync", _failing(errno.ENOSPC, os.fsync, calls=2))  # the first save, and an iteration's
    run = tmp_path / "run"
    arguments = ["train", *tiny, "--logging.checkpoint-seconds", "0", "--output", run]
    refused(arguments, f"{run / 'checkpoint.pt'}: No space left", "goes on from its last checkpoint with --resume")
    monkeypatch.undo()
    assert load_checkpoint(run)["frames"] == 4
    assert not [file for file in run.iterdir() if file.name.startswith(".")]
    assert main(["train", "--resume", str(run)]) == 0
    assert load_checkpoint(run)["frames"] == 8


def test_a_write_that_stops_halfway_leaves_the_last_checkpoint(tmp_path, untouched_run):
    path = tmp_path / "checkpoint.pt"
    state = load_checkpoint(untouched_run)
    save_checkpoint(path, {**state, "frames": 1})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large") as caught:
            save_checkpoint(path, {**state, "frames": 2})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert explain(caught.value) == f"{path}: File too large; raise the limit of file sizes (ulimit -f)"
    assert load_checkpoint(path)["frames"] == 1
    assert list(tmp_path.iterdir()) == [path]


def test_a_log_that_a_kill_cut_short_is_no_hindrance(tmp_path, tiny):
    run = tmp_path / "run"
    assert main(["train", *tiny, "--output", str(run)]) == 0
    log = run / "progress.csv"
    header, *rows = log.read_text().splitlines(keepends=True)
    log.write_text("".join([header, *rows, rows[-1][:20]]))
    assert main(["train", "--resume", str(run), "--total-frames", "12"]) == 0
    assert len(log.read_text().splitlines()) == 1 + 3


def test_a_log_of_something_else_is_not_written_over(refused, tmp_path, tiny):
    run = tmp_path / "run"
    assert main(["train", *tiny, "--output", str(run)]) == 0
    (run / "progress.csv").write_text("groceries\n")
    refused(["train", "--resume", run, "--total-frames", "12"], "progress.csv is not the log of a run", "move it away")
    assert (run / "progress.csv").read_text() == "groceries\n"

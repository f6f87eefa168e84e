"""Text survives any encoding, any reader and any size."""

from __future__ import annotations

import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from torchrl_atr._text import number
from torchrl_atr.cli import commands, main
from torchrl_atr.cli.parser import build_parser
from torchrl_atr.cli.printing import estimator_lines, replay_head, replay_line
from torchrl_atr.cli.summary import next_commands
from torchrl_atr.training import TrainConfig
from torchrl_atr.training import progress as progress_module

EVERYTHING = """
import os, sys, warnings
warnings.filterwarnings("error", category=EncodingWarning, module=r"(torchrl_atr|benchmarks)\\b")
from torchrl_atr.cli import main
run = os.fsdecode("r \\u00e4\\U0001f680".encode())
settings = ["--ppo.rollout-steps", "4", "--ppo.minibatches", "1", "--compute.num-threads", "1"]
few = ["--robots-per-command", "1", "--max-speed", "0", "--max-yaw-rate", "0"]
for words in (
    ["train", "--num-envs", "4", "--total-frames", "48", *settings, "--output", run],
    ["train", "--resume", run, "--total-frames", "64"],
    ["evaluate", run, *few],
    ["list", "questions"],
    ["model", "a1", "two_board", "--output", run + "/m.xml"],
):
    assert main(words) == 0, words
print("printed by a library: \\u03c9")
"""


def test_every_command_writes_in_any_encoding_and_utf8_to_files(tmp_path):
    """In a locale of ASCII alone; paths are written as the bytes that they are, to be pasted."""
    command = [sys.executable, "-X", "warn_default_encoding", "-c", EVERYTHING]
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, env={**os.environ, **locale}, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    assert b"printed by a library: \\u03c9" in done.stdout
    run = tmp_path / "r ä🚀"
    assert {"metrics.json", "checkpoint.pt", "m.xml", "heatmaps.png"} <= {path.name for path in run.iterdir()}
    (run / "metrics.json").read_text(encoding="utf-8")
    assert "torchrl-atr evaluate 'r ä🚀' ".encode() in done.stdout


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-16"])
def test_a_list_is_written_in_any_encoding(monkeypatch, encoding):
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding=encoding))
    assert main(["list", "questions"]) == 0
    text = written.getvalue().decode(encoding)
    assert ("ω" if encoding == "utf-16" else "\\u03c9") in text


@pytest.mark.parametrize("words", ["list settings", "--help"])
def test_a_reader_that_leaves_ends_it_quietly(words):
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "torchrl_atr.cli", *words.split()]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, timeout=120)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")


def test_no_standard_output_is_no_error(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", None)  # of a process that was started with >&-
    assert main(["list", "rewards"]) == 0
    assert capsys.readouterr().err == ""


def test_numbers_keep_to_their_columns():
    values = (0.0, -1.5, 1234.5678, -98765.4321, 1e12, -3.2e-8, 1e300, float("inf"), float("nan"), None)
    assert {len(number(value, 8, 3)) for value in values} == {8}
    assert number(1234.5678, 8, 3) == "1234.568"
    assert float(number(-98765.4321, 8, 3)) == pytest.approx(-98765, rel=0.01)


def _replayed(value):
    return SimpleNamespace(
        step=int(value),
        speed=value,
        yaw_rate=-value,
        tilt=value,
        largest_velocity=value,
        largest_action=value,
        diverged=False,
    )


@pytest.mark.parametrize("value", [0.0, 123.456, 123456.789, 1.5e7])
def test_the_columns_of_a_replay_do_not_run_together(value):
    head, line = replay_head(), replay_line(_replayed(value))
    assert len(line) == len(head)
    cells = line.split()
    assert len(cells) == 6
    assert [float(cell) for cell in cells[1:]] == pytest.approx([value, -value, value, value, value], rel=0.01)


@pytest.mark.parametrize("size", [1.0, 1e3, 1e9, float("nan")])
def test_lines_of_training_fit_120_columns(tmp_path, capsys, size):
    progress = progress_module.Progress(tmp_path, TrainConfig())
    progress._shown = {each.name: 1.2345 * size for each in progress_module._COLUMNS}
    progress._shown |= {"frames": 123_456_789, "minutes": 60.0 * 99}
    lines = [*progress_module._HEAD.splitlines(), progress._line()]
    assert {len(line) for line in lines} == {119}
    assert len(lines[-1].split()) == len(progress_module._COLUMNS) + 1
    progress._shown = {"frames": 100, "minutes": 1.0}  # what the first iterations lack
    assert progress._line().split()[1:-1] == ["-"] * (len(progress_module._COLUMNS) - 1)


def test_training_ends_with_where_the_run_is_and_what_comes_next(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tiny = ["--num-envs", "2", "--ppo.rollout-steps", "4", "--ppo.minibatches", "1", "--compute.num-threads", "1"]
    assert main(["train", *tiny, "--total-frames", "16", "--output", "my run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    ended = next(i for i, line in enumerate(lines) if line.startswith("finished"))
    assert re.match(r"finished after 16 robot steps in \d\.\d minutes; the run is in 'my run'", lines[ended])
    assert re.match(r"last 2 iterations, exploring: .* m/s and .* rad/s off the command", lines[ended + 1])
    assert re.search(r"steps a second: \d+% of the time to collect, \d+% to learn, \d+% for logs", lines[ended + 2])
    assert lines[ended + 4].split("#")[0].strip() == "torchrl-atr evaluate 'my run'"
    for line in lines[ended + 4 :]:  # every command exists
        build_parser().parse_args(shlex.split(line, comments=True)[1:])


def test_training_that_is_stopped_says_how_to_go_on(capsys):
    learner = SimpleNamespace(networks=None)
    counters = {"frames": 1000, "seconds": 90.0, "config": TrainConfig()}
    trainer = SimpleNamespace(train=lambda: 15, run=Path("runs/x"), learner=learner, **counters)
    assert commands._train(trainer) == 143
    assert capsys.readouterr().out.splitlines()[:3] == [
        "stopped after 1,000 robot steps in 1.5 minutes; the run is in runs/x",
        "go on with: torchrl-atr train --resume runs/x",
        "next:",
    ]


def test_what_comes_next_fits_the_policy():
    teacher, walker = next_commands(Path("runs/x"), teacher=True), next_commands(Path("runs/x"), task="balance")
    assert teacher[1].split("#")[0].strip() == "torchrl-atr evaluate runs/x --act-source privileged"
    for lines in (teacher, walker):
        assert not any(" export " in line for line in lines)
    assert " export " in next_commands(Path("runs/x"))[-1]


def test_every_extrinsic_state_has_a_name_and_a_unit():
    from torchrl_atr.envs import RidingEnv
    from torchrl_atr.evaluation.access import extrinsic_components

    env = RidingEnv(num_envs=1, seed=0)
    size = env.reset()["privileged", "extrinsic"].shape[-1]
    components = extrinsic_components(env, size)
    assert len({component.label for component in components}) == size == 16
    assert components[0] == ("contacts[0]", "contact FR", "1")
    assert components[4] == ("body_velocity[0]", "body velocity x", "m/s")
    assert components[15] == ("relative_yaw[0]", "relative yaw", "rad")
    assert all(component.unit for component in components)


def test_table_v_is_printed_with_names_and_units():
    rows = [{"name": "body_velocity[0]", "label": "body velocity x", "unit": "m/s", "mean": 0.1, "std": 0.2}]
    latent = {"label": "intrinsics' latent (norm)", "unit": "1", "mean": 0.5, "std": 1e9}
    _, first, second = estimator_lines({"latent": latent, "extrinsic": rows})
    assert first.split() == ["intrinsics'", "latent", "(norm)", "0.500", "1.00e+09"]
    assert second.split() == ["body", "velocity", "x,", "m/s", "0.100", "0.200"]
    assert list(estimator_lines(None)) == []

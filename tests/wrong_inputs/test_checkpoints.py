"""Wrong checkpoints: whoever reads a run says what is wrong with it, and leaves it as it is."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from torchrl_atr.config.nested import merged

NAME = "checkpoint.pt"


class Code:
    """Runs a command when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self):
        return os.system, (f"touch {self.trace}",)


def _settings(**changes: object) -> Callable[[dict], object]:
    changed = {path.replace("__", "."): value for path, value in changes.items()}
    return lambda state: state.update(config=merged(state["config"], changed))


def _drop(*path: str) -> Callable[[dict], object]:
    def drop(state: dict) -> None:
        for name in path[:-1]:
            state = state[name]
        del state[path[-1]]

    return drop


def _fill(value: float) -> Callable[[dict], object]:
    def fill(state: dict) -> None:
        for name in ("networks", "deployed"):
            state["learner"][name]["encoder.net.0.even.weight"].fill_(value)

    return fill


@pytest.mark.parametrize(
    ("change", "culprit", "remedy"),
    [
        (lambda state: state.update(version=99), "version 99; this code reads version 4", "use the torchrl_atr"),
        (lambda state: state.update(version=1), "version 1; this code reads version 4", "scripts/convert_run.py"),
        (_drop("version"), "is not a checkpoint of ours", "give a run folder"),
        (_drop("learner", "networks"), "lacks 'learner/networks'", "give a folder that"),
        (_drop("config"), "lacks 'config'", "give a folder that"),
        (_settings(ppo__critic_cells=[32]), "size mismatch for critic.net.0.even.weight", "use the code, the settings"),
        (_settings(estimator__name="mlp"), "intrinsic_estimator.net", "use the code, the settings"),
        (_settings(env__history_length=3), "size mismatch for intrinsic_est", "use the code, the settings"),
        (_settings(estimator__name="my_own"), "unknown estimator 'my_own'", "register_estimator"),
        (_settings(imports=["no_such_module"]), "cannot import 'no_such_module'", "run where it can be found"),
        (_settings(task__robot="/gone/mine.toml"), "no robot file /gone/mine.toml", "check its path"),
        (_settings(tomorrows_setting=1), "unknown setting 'tomorrows_setting'", "list settings"),
        (_fill(float("nan")), "NaN or infinity in encoder.net.0.even.weight", "use an earlier checkpoint"),
    ],
)
@pytest.mark.parametrize(
    "command",
    [("train", "--resume"), ("train", "--output", "no_run", "--from"), ("evaluate",)],
    ids=["resume", "from", "evaluate"],
)
def test_another_content_is_refused(refused, tmp_path, untouched_run, command, change, culprit, remedy):
    state = torch.load(untouched_run / NAME, weights_only=True)
    change(state)
    torch.save(state, tmp_path / NAME)
    refused([*command, tmp_path], culprit, remedy)
    assert [file.name for file in tmp_path.iterdir()] == [NAME]


def _cut(data: bytes) -> bytes:
    return data[: len(data) // 2]


def _flip(data: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:  # not of what pads the entries: nobody reads that
        largest = max((archive.read(entry) for entry in archive.infolist()), key=len)
    place = data.index(largest) + len(largest) // 2
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


@pytest.mark.parametrize("damage", [_cut, _flip, lambda data: b"", lambda data: b"frames,reward\n1,2\n"])
def test_a_damaged_file_is_refused(refused, tmp_path, untouched_run, damage):
    data = damage((untouched_run / NAME).read_bytes())
    (tmp_path / NAME).write_bytes(data)
    refused(["evaluate", tmp_path], f"the checkpoint {tmp_path / NAME} cannot be read", "restore the file")
    assert (tmp_path / NAME).read_bytes() == data


def test_code_is_not_run(refused, tmp_path):
    trace = tmp_path / "was_here"
    torch.save({"version": 1, "config": Code(trace)}, tmp_path / NAME)
    refused(["play", tmp_path], "more than tensors and numbers", "give a checkpoint that")
    assert not trace.exists()


@pytest.mark.parametrize("folder", ["nowhere", "."])
def test_a_folder_without_a_checkpoint_is_refused(refused, tmp_path, folder):
    refused(["train", "--resume", tmp_path / folder], f"no checkpoint at {tmp_path}", "give a run folder")


def test_a_run_trained_elsewhere_is_evaluated_and_resumed_on_the_cpu(refused, tmp_path, untouched_run, capsys):
    state = torch.load(untouched_run / NAME, weights_only=True)
    state["config"]["compute"]["device"] = "cuda:99"
    state["frames"] = state["config"]["total_frames"]
    torch.save(state, tmp_path / NAME)
    refused(["play", tmp_path, "--video", "ride.avi"], "'ride.avi'", ".mp4")  # its networks were loaded before
    refused(["train", "--resume", tmp_path], "device='cuda:99'", "use 'cpu'")
    from torchrl_atr.cli import main

    assert main(["train", "--resume", str(tmp_path), "--device", "cpu"]) == 0
    assert "has ended; to go on, give a larger --total-frames" in capsys.readouterr().out

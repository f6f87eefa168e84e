"""Checkpoints survive a round trip, and damage is named."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.runs.checkpoint import VERSION
from torchrl_atr.training import CheckpointError, load_checkpoint, save_checkpoint


def test_round_trip_and_no_temporary_left(tmp_path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, {"weights": torch.arange(3.0), "frames": 7, "nested": {"a": [1, 2]}})
    state = load_checkpoint(tmp_path)
    assert torch.equal(state["weights"], torch.arange(3.0))
    assert (state["frames"], state["nested"]) == (7, {"a": [1, 2]})
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]


class Unsafe:
    """Is pickled, but only plain tensors are read."""


def test_a_failed_save_leaves_the_old_checkpoint(tmp_path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, {"frames": 1})
    with pytest.raises(CheckpointError, match="holds more than tensors and numbers"):
        save_checkpoint(path, {"frames": Unsafe()})
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]
    assert load_checkpoint(path)["frames"] == 1


def test_the_one_before_stays_and_stands_in(tmp_path, caplog):
    path = tmp_path / "checkpoint.pt"
    for frames in (1, 2, 3):
        save_checkpoint(path, {"frames": frames}, best=frames == 2)
    names = ("checkpoint.pt", "previous.pt", "best.pt")
    assert [load_checkpoint(tmp_path / name)["frames"] for name in names] == [3, 2, 2]
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(names)
    path.write_bytes(path.read_bytes()[:100])
    assert load_checkpoint(tmp_path)["frames"] == 2
    assert "may be truncated" in caplog.text
    path.unlink()
    assert load_checkpoint(tmp_path)["frames"] == 2


def test_a_damaged_one_does_not_take_the_place_of_its_stand_in(tmp_path):
    path = tmp_path / "checkpoint.pt"
    for frames in (1, 2):
        save_checkpoint(path, {"frames": frames})
    path.write_bytes(path.read_bytes()[:100])
    save_checkpoint(path, {"frames": 3})
    assert [load_checkpoint(tmp_path / name)["frames"] for name in ("checkpoint.pt", "previous.pt")] == [3, 1]


@pytest.mark.parametrize("keep", [0, 10, 200])
def test_truncated(tmp_path, keep):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, {"weights": torch.zeros(100)})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt cannot be read, it may be truncated"):
        load_checkpoint(path)


def test_missing_and_foreign(tmp_path):
    with pytest.raises(CheckpointError, match="there is no checkpoint at"):
        load_checkpoint(tmp_path)
    torch.save({"version": 99}, tmp_path / "checkpoint.pt")
    with pytest.raises(CheckpointError, match=f"checkpoint version 99; this code reads version {VERSION}"):
        load_checkpoint(tmp_path)


@pytest.mark.parametrize("name", ["checkpoint.pt", "best.pt"])
def test_one_of_an_earlier_version_says_how_it_is_converted_and_has_no_stand_in(tmp_path, name):
    run = tmp_path / "my run"
    save_checkpoint(run / "previous.pt", {"frames": 1})
    torch.save({"version": 1, "frames": 2}, run / name)
    with pytest.raises(CheckpointError, match=rf"convert it with `python scripts/convert_run\.py '{run}'`"):
        load_checkpoint(run if name == "checkpoint.pt" else run / name)

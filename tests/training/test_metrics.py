"""What a batch of a known course comes to."""

import csv

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.training import TrainConfig
from torchrl_atr.training.metrics import batch_metrics
from torchrl_atr.training.progress import Progress


def _batch(terminated, student=None):
    shape = torch.tensor(terminated).shape
    flags = torch.tensor(terminated, dtype=torch.bool).unsqueeze(-1)
    after = {
        "reward": torch.ones(*shape, 1),
        "speeds": torch.ones(*shape, 2),
        "terminated": flags,
        "done": flags,
    }
    batch = TensorDict({"command": torch.zeros(*shape, 2), "next": after}, shape)
    if student is not None:
        batch["act", "student"] = torch.tensor(student).reshape(-1, 1, 1).expand(*shape, 1)
    return batch


def test_falls_per_minute_by_hand():
    """Two robots of five steps, 0.2 s of riding in all, in which one of them falls twice."""
    metrics = batch_metrics(_batch([[0, 1, 0, 0, 1], [0, 0, 0, 0, 0]], [False, True]))
    assert metrics["falls_per_minute"] == pytest.approx(2 / (0.2 / 60))
    assert metrics["student_falls_per_minute"] == 0.0
    assert "student_falls_per_minute" not in batch_metrics(_batch([[0, 1]]))


def test_a_robot_that_turns_half_as_fast_as_it_should_has_a_yaw_gain_of_a_half():
    batch = _batch([[0, 0, 0, 0]])
    batch["command"] = torch.tensor([[[0.0, 1.0], [1.0, -0.6], [1.0, 0.2], [0.0, 0.0]]])
    batch["next", "speeds"] = 0.5 * batch["command"]
    assert batch_metrics(batch)["yaw_gain"] == pytest.approx(0.5)


def test_falls_are_shown_as_a_moving_mean_and_logged_as_they_are(tmp_path):
    progress = Progress(tmp_path, TrainConfig(), logger=_Logger())
    for frames, falls in ((1, 60.0), (2, 0.0), (3, 0.0), (4, 0.0)):
        progress.update({"frames": frames, "minutes": 1.0, "falls_per_minute": falls})
    assert progress._shown["falls_per_minute"] == 15.0
    assert progress._shown["up_after_a_minute"] == pytest.approx(3.06e-7, rel=1e-2)
    rows = (tmp_path / "progress.csv").read_text(encoding="utf-8").splitlines()
    column = rows[0].split(",").index("falls_per_minute")
    assert [float(row.split(",")[column]) for row in rows[1:]] == [60, 0, 0, 0]


def test_a_row_of_the_log_holds_what_its_iteration_measured_alone(tmp_path):
    progress = Progress(tmp_path, TrainConfig(), logger=_Logger())
    progress.update({"frames": 1, "minutes": 1.0, "episode_reward": 5.0})
    progress.update({"frames": 2, "minutes": 2.0})  # no episode ended
    assert progress._shown["episode_reward"] == 5.0
    rows = list(csv.DictReader((tmp_path / "progress.csv").open(newline="", encoding="utf-8")))
    assert [row["episode_reward"] for row in rows] == ["5", ""]


class _Logger:
    def log_metrics(self, *arguments, **options): ...

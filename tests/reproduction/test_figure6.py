"""Figure 6: figures of rides that are known, and refusals before anything is simulated."""

from __future__ import annotations

import json

import numpy as np
import pytest

from torchrl_atr.cli import main
from torchrl_atr.evaluation.sequence import SequenceResult
from torchrl_atr.reproduction import figure6 as module
from torchrl_atr.reproduction.figure6 import Sizes, figure6, load_sequence, save_sequence, sequence_figures


def ridden(noise):
    """Two robots on a ramp; the second one fell after half of the ride, and what comes after must not count."""
    time = np.arange(100) * 0.02
    truth = np.broadcast_to(time[:, None, None], (100, 2, 2)).copy()
    up = np.ones((100, 2), dtype=bool)
    up[50:, 1] = False
    achieved = np.where(up[..., None], truth + 0.5, 1e6)
    return SequenceResult(
        time, np.stack([time, time], -1), truth, achieved, up, np.where(up[..., None], truth + noise, 1e6), truth
    )


def test_errors_are_over_the_steps_before_a_fall():
    figures = sequence_figures(ridden(0.1))
    assert figures["survival"] == 0.5
    assert figures["speed_rms"] == pytest.approx(0.5)
    assert figures["yaw_rate_estimate_error"] == pytest.approx(0.1)
    t = np.concatenate([np.arange(100), np.arange(50)]) * 0.02
    assert figures["speed_explained"] == pytest.approx(1 - 0.01 / t.var())
    assert sequence_figures(ridden(0.0))["speed_explained"] == 1.0


def test_rides_are_written_and_read_back(tmp_path):
    save_sequence(ridden(0.1), tmp_path / "ride.npz")
    back = load_sequence(tmp_path / "ride.npz")
    np.testing.assert_array_equal(back.up, ridden(0.1).up)
    np.testing.assert_allclose(back.estimated[:50], ridden(0.1).estimated[:50], rtol=1e-6)


def test_the_report_has_a_figure_and_arrays_for_each_pair(job, tmp_path):
    page = figure6(job, tmp_path, sizes=Sizes(robots=2, seconds=0.1)).read_text()
    assert "![commanded, achieved and estimated velocity, a1-single_board](a1-single_board.png)" in page
    (row,) = json.loads((tmp_path / "figure6.json").read_text())["pairs"]
    assert (row["robots"], row["seconds"]) == (2, 0.1)
    with np.load(tmp_path / "a1-single_board.npz") as arrays:
        assert arrays["estimated"].shape == (5, 2, 2)


@pytest.mark.parametrize("command", ["reproduce figure6 --policies RUN --output OUT", "play RUN"])
def test_a_command_out_of_range_is_refused_before_the_simulation(untrained_run, tmp_path, capsys, monkeypatch, command):
    monkeypatch.setattr(module, "evaluate_sequence", None)
    words = [{"RUN": str(untrained_run), "OUT": str(tmp_path / "out")}.get(word, word) for word in command.split()]
    file = tmp_path / "ride.csv"
    file.write_text("time,speed,yaw_rate\n0,9,0\n")
    assert main([*words, "--commands", str(file)]) == 2
    assert "is beyond the policy's range: speed in [-2.2, 2.2] m/s" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [file]

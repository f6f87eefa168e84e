"""The mastered commands on the joystick's pad, and the policies that are listed."""

from __future__ import annotations

import numpy as np
import pytest

from torchrl_atr._errors import UserError
from torchrl_atr.modules import CommandRange
from torchrl_atr.viewer import CommandArea, default_policy, mastered_area, ridable, sources
from torchrl_atr.viewer.area import _MASTERED, pad_picture


def test_the_picture_has_speed_upwards_and_a_left_turn_on_the_left():
    speeds, yaw_rates = np.array([-1.0, 0.0, 1.0]), np.array([-0.5, 0.0, 0.5])
    mastered = np.zeros((3, 3), dtype=bool)
    mastered[2, 2] = True  # fast, and turning to the left
    picture = pad_picture(CommandArea(speeds, yaw_rates, mastered, ""), (1.0, 0.5), size=41)
    green = (picture == _MASTERED).all(-1)
    assert green[3, 3]
    assert not green[3, -4]
    assert not green[-4].any()
    larger = pad_picture(CommandArea(speeds, yaw_rates, mastered, ""), (4.0, 2.0), size=81)
    assert not (larger == _MASTERED).all(-1)[:20].any()  # nothing is known beyond the evaluation


def test_an_evaluation_goes_before_a_range_and_a_damaged_one_does_not(tmp_path):
    limits = CommandRange(3.0, 1.0)
    assert mastered_area(tmp_path, None) is None
    assert mastered_area(tmp_path, limits).limits == (3.0, 1.0)
    (tmp_path / "tracking.npz").write_bytes(b"half a file")
    assert mastered_area(tmp_path, limits).limits == (3.0, 1.0)


def test_runs_are_listed_newest_first_behind_the_one_that_was_given(run, tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "policies", dict)
    assert list(ridable(run, runs=run.parent)) == [run.as_posix()]
    assert default_policy(run.parent) == run
    with pytest.raises(UserError, match="torchrl-atr train"):
        default_policy(tmp_path)
    assert sources.checkpoints_of(run)[0] == "last"

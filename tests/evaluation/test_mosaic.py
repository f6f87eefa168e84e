"""Several rides in one moving picture: the grid, the frames, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from tensordict.nn import TensorDictModule

from torchrl_atr._errors import InputError
from torchrl_atr.envs import make_riding_env
from torchrl_atr.evaluation.mosaic import record_mosaic, tiled


@pytest.fixture
def riders():
    made = {}
    for robot in ("a1", "go1", "spot"):
        env = make_riding_env(robot, num_envs=1, pushes=False, num_threads=1)
        stand = TensorDictModule(lambda o: o.new_zeros(len(o), 12), in_keys=["observation"], out_keys=["action"])
        made[robot] = stand, env
    return made


def test_pictures_stand_row_by_row():
    pictures = [np.full((2, 3, 3), value, np.uint8) for value in (1, 2, 3)]
    grid = tiled(pictures, 2)
    assert grid.shape == (4, 6, 3)
    assert [grid[0, 0, 0], grid[0, 5, 0], grid[3, 0, 0], grid[3, 5, 0]] == [1, 2, 3, 0]


def test_all_ride_in_one_picture(riders, tmp_path):
    try:
        frames = record_mosaic(riders, tmp_path / "riding.gif", seconds=0.4, fps=10, columns=2, size=(64, 48))
    except RuntimeError as error:
        if "cannot render" not in str(error):
            raise
        pytest.skip(f"no OpenGL here: {error}")
    with Image.open(tmp_path / "riding.gif") as picture:
        assert (picture.size, frames) == ((128, 96), 4)
        assert picture.n_frames > 1
        first = np.asarray(picture.convert("RGB"))
    assert first[:48, :64].std() > 5.0
    assert first[48:, 64:].mean() < 8.0  # there are three riders


@pytest.mark.parametrize("wrong", [{"riders": {}}, {"seconds": 0.1}, {"fps": 0.0}, {"columns": 0}])
def test_bad_input_is_named(riders, tmp_path, wrong):
    with pytest.raises(InputError, match="cannot be; give at least one rider"):
        record_mosaic(**{"riders": riders, "path": tmp_path / "riding.gif"} | wrong)
    assert not list(tmp_path.iterdir())

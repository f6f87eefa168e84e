import json
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest

from torchrl_atr._files import atomic
from torchrl_atr.evaluation import (
    EstimationErrors,
    load_tracking,
    save_tracking,
    tracking_metrics,
    write_report,
)
from torchrl_atr.evaluation.access import Component


@pytest.fixture
def full_result(random_result):
    """With estimator errors."""
    shape = random_result.fall_time.shape
    errors = np.random.default_rng(0).random((*shape, 2))
    components = Component("a", "a", "m"), Component("b[0]", "b x", None)
    estimators = EstimationErrors(np.full(shape, 3.0), components, errors, errors**2)
    return replace(random_result, estimators=estimators)


def _assert_same(ours, theirs):
    for field in fields(ours):
        a, b = getattr(ours, field.name), getattr(theirs, field.name)
        if isinstance(a, EstimationErrors):
            _assert_same(a, b)
        elif isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
        else:
            assert a == b


def test_tracking_survives_a_round_trip(full_result, random_result, tmp_path):
    for result in (full_result, random_result):
        save_tracking(result, tmp_path / "tracking.npz")
        _assert_same(result, load_tracking(tmp_path / "tracking.npz"))
    assert tracking_metrics(load_tracking(tmp_path / "tracking.npz")) == tracking_metrics(random_result)


def test_a_file_that_is_no_tracking_file_is_named(tmp_path):
    np.savez(tmp_path / "other.npz", x=np.zeros(2))
    with pytest.raises(KeyError, match=r"other\.npz lacks speed_commands"):
        load_tracking(tmp_path / "other.npz")


def test_a_report_holds_every_file_and_nothing_else(full_result, tmp_path):
    metrics = {**tracking_metrics(full_result), "seed": 3}
    paths = write_report(full_result, metrics, tmp_path / "new" / "folder")
    names = {"metrics.json", "tracking.npz", "heatmaps.png", "response.png", "command_area.png"}
    assert set(paths) == names == {path.name for path in (tmp_path / "new" / "folder").iterdir()}
    assert json.loads(paths["metrics.json"].read_text(encoding="utf-8")) == metrics


def test_nan_never_reaches_the_file(random_result, tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_report(random_result, {"survival": float("nan")}, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text("old")

    def fail():
        with atomic(path) as file:
            file.write_text("half")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_importing_evaluation_imports_no_matplotlib():
    code = (
        "import sys, torchrl_atr.evaluation\n"
        "assert not {'matplotlib', 'mediapy', 'dm_control', 'OpenGL'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)

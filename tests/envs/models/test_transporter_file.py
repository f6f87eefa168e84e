"""Transporters of one's own: a TOML file, and all that can be wrong with it."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

from torchrl_atr.envs import ROBOTS, RidingEnv, get_transporter, read_transporter
from torchrl_atr.envs.models import TRANSPORTERS, TransporterError
from torchrl_atr.envs.models.transporter import describe_transporter
from torchrl_atr.training import make_config

A1, BOARD = ROBOTS.get("a1"), TRANSPORTERS.get("single_board_g1")
FACTS = {"name": "wide", "design": "two_board", "size": [0.9, 0.9, 0.05], "mass": 14, "resistance": [0.1, 0, 0]}
NUMBERS = ("mass", "max_acceleration", "max_yaw_acceleration", "tilt_norm", "spring_scale")
LISTS = {"size": 3, "resistance": 3, "sb_stiffness": 2, "sb_damping": 2}


def written(folder, **changes):
    path = folder / "wide.toml"
    facts = {name: value for name, value in {**FACTS, **changes}.items() if value is not None}
    lines = [
        f"{name} = {json.dumps(value).replace('NaN', 'nan').replace('Infinity', 'inf')}"
        for name, value in facts.items()
    ]
    path.write_text("\n".join(lines))
    return path


def test_a_file_is_a_transporter_wherever_one_is_chosen(tmp_path, monkeypatch):
    path = written(tmp_path)
    spec = read_transporter(path)
    assert spec == dataclasses.replace(
        TRANSPORTERS.get("two_board_g1"), name="wide", size=(0.9, 0.9, 0.05), mass=14, resistance=(0.1, 0, 0)
    )
    assert get_transporter(str(path), A1) == spec
    assert get_transporter(describe_transporter(spec), A1) == spec
    assert describe_transporter(BOARD) == "single_board_g1"
    env = RidingEnv(transporter=path, num_envs=1, seed=0, num_threads=1)
    assert env.rollout(2)["next", "observation"].isfinite().all()
    np.testing.assert_allclose(env.model.geom("deck_left").size, [0.45, 0.225, 0.025])
    monkeypatch.chdir(tmp_path)
    assert make_config({"task.transporter": "wide.toml"}).task.transporter == str(path.resolve())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": None}, "there is no mass; a transporter needs name, design, size, mass"),
        ({"weight": 3}, "unknown key 'weight'"),
        ({"masss": 3}, "unknown key 'masss'; did you mean 'mass'?"),
        ({"design": "unicycle"}, "design='unicycle' is none; choose one of single_board, two_board"),
        ({"design": 2}, "design=2 is none"),
        ({"name": ""}, "name='' is not a name"),
        ({"mass": 1e300}, "mass=1e+300 must be positive"),
        ({"mass": 10**400}, "must be positive"),
        ({"mass": 1e-300}, "mass=1e-300 must be positive"),
        ({"sb_stiffness": [1e300, 1]}, "sb_stiffness holds 1e+300"),
        ({"tilt_norm": 45}, "tilt_norm=45: degrees? give radians"),
        ({"size": 3.0}, "size=3.0 is not a list; give length, width and thickness in m"),
    ],
)
def test_a_wrong_file_names_the_fix(tmp_path, changes, message):
    with pytest.raises(TransporterError, match=f"wide.toml: .*{re.escape(message)}"):
        read_transporter(written(tmp_path, **changes))


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), True, "heavy", None])
@pytest.mark.parametrize("name", NUMBERS)
def test_impossible_numbers_are_refused_by_name(name, value):
    with pytest.raises(TransporterError, match=f"'single_board_g1': {name}={re.escape(repr(value))} must be positive"):
        dataclasses.replace(BOARD, **{name: value})


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("-inf"), True, "x", None, [0.1]])
@pytest.mark.parametrize("name", LISTS)
def test_impossible_entries_are_refused_by_name(name, value, tmp_path):
    values = [value, *getattr(BOARD, name)[1:]]
    with pytest.raises(TransporterError, match=f"'single_board_g1': {name}"):
        dataclasses.replace(BOARD, **{name: values})
    with pytest.raises(TransporterError, match=f"{name} has {LISTS[name] + 1} entries instead of {LISTS[name]}"):
        dataclasses.replace(BOARD, **{name: [1.0] * (LISTS[name] + 1)})
    if value is not None:
        with pytest.raises(TransporterError, match=f"wide.toml: transporter 'wide': {name}"):
            read_transporter(written(tmp_path, **{name: values}))

"""Files of commands: what is read, and what is refused before anything moves."""

from __future__ import annotations

import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.evaluation.command_file import check_commands, command_file_names, duration, read_commands
from torchrl_atr.modules import CommandRange

CSV = "# a comment\nspeed, time, yaw_rate\n1.5, 0, -0.5\n\n0, 2.5, 0\n"
TOML = "[[command]]\ntime = 0\nspeed = 1.5\nyaw_rate = -0.5\n[[command]]\ntime = 2.5\nspeed = 0\nyaw_rate = 0\n"


def written(tmp_path, text, suffix=".csv"):
    path = tmp_path / f"ride{suffix}"
    path.write_text(text)
    return path


def test_both_kinds_of_files_say_the_same(tmp_path):
    commands = ((0.0, 1.5, -0.5), (2.5, 0.0, 0.0))
    assert read_commands(written(tmp_path, CSV)) == commands
    assert read_commands(written(tmp_path, TOML, ".toml")) == commands
    assert duration(commands) == 7.5


def test_the_files_of_the_package_are_within_the_range_that_the_recipe_trains():
    from torchrl_atr.training import TrainConfig

    for name in command_file_names():
        check_commands(read_commands(name), CommandRange(*TrainConfig().grid.bounds))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,speed\n0,1\n", "line 1: no column yaw_rate"),
        ("time,speed,yaw\n0,1,0\n", "line 1: unknown column 'yaw'"),
        ("time,speed,yaw_rate,speed\n0,1,0,1\n", "a column stands there twice"),
        ("time,speed,yaw_rate\n0,1,0\n2,,0\n", "line 3: speed is missing; fill the gap"),
        ("time,speed,yaw_rate\n0,1\n", "line 2: yaw_rate is missing; fill the gap"),
        ("time,speed,yaw_rate\n0,1,0,4\n", "line 2: 4 entries for 3 columns"),
        ("time,speed,yaw_rate\n1,1,0\n", "line 2: the first command begins at 1 s"),
        ("time,speed,yaw_rate\n0,1,0\n2,1,0\n2,0,0\n", "line 4: time 2 does not come after 2; times must increase"),
        ("time,speed,yaw_rate\n0,fast,0\n", "line 2: speed='fast' is no finite number"),
        ("time,speed,yaw_rate\n0,nan,0\n", "line 2: speed='nan' is no finite number"),
        ("time,speed,yaw_rate\n", "holds no command"),
        ("", "holds no command"),
    ],
)
def test_a_wrong_csv_file_is_refused_by_its_line(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_commands(written(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[command]]\ntime = 0\nspeed = 1\n", "command 1: no entry yaw_rate"),
        ("[[command]]\ntime = 0\nspeed = true\nyaw_rate = 0\n", "speed=True is no finite number"),
        ("commands = 3\n", r"write a table \[\[command\]\]"),
        ("[[command]\n", "is not valid TOML"),
    ],
)
def test_a_wrong_toml_file_is_refused(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_commands(written(tmp_path, text, ".toml"))


@pytest.mark.parametrize(
    ("source", "words"), [("figure", "no file of commands.*'figure6'"), ("x.csv", "check its path")]
)
def test_a_file_that_is_missing_is_refused(source, words):
    with pytest.raises(InputError, match=words):
        read_commands(source)


def test_commands_beyond_a_range_are_named():
    ride, limits = [(0.0, 1.0, 1.0), (3.0, 2.0, 1.0)], CommandRange(2.0, 1.0, max_lateral_acceleration=1.5)
    check_commands(ride[:1], limits)
    with pytest.raises(InputError, match=r"at 3 s, 2 m/s and 1 rad/s.*up to 1.5 m/s²; choose a smaller one"):
        check_commands(ride, limits)
    with pytest.raises(InputError, match=r"at 0 s, -1 m/s.*speed in \[0, 2\]"):
        check_commands([(0.0, -1.0, 0.0)], CommandRange(2.0, 1.0, forward_only=True))

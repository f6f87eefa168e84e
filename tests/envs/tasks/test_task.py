"""A task's fields are checked where it is written: what is wrong is named, with what to give."""

from __future__ import annotations

import dataclasses

import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.envs.tasks import TASKS, CommandSpace, Disturbance, make_task, riding, walking
from torchrl_atr.envs.tasks.events import push_robot

WALKING = walking("a1")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"name": 3}, "name=3; give a text"),
        ({"robot": "a1"}, "robot='a1'; give a RobotSpec"),
        ({"support": "plate"}, "support='plate'; give a Support"),
        ({"command": None}, "command=None: give a CommandSpace"),
        ({"observations": None}, "observations=None; give a mapping"),
        ({"observations": {}}, "observations lack 'proprio'"),
        ({"rewards": [1]}, r"rewards=\[1\]; give a mapping of names to RewardTerm"),
        ({"intrinsics": None}, "intrinsics=None; give a mapping"),
        ({"terminations": [len]}, r"terminations=\[.*; give a mapping"),
        ({"disturbances": {"push": push_robot}}, "the disturbance 'push' is <function.*give a Disturbance"),
        ({"memory": None}, "memory=None; give a mapping"),
        ({"tracking": "forward_command"}, "tracking='forward_command'; give a list"),
        ({"readings": "literal"}, "readings='literal'; give Readings"),
        ({"reset": 3}, "reset=3 cannot be called"),
        ({"hook": 3}, "hook=3 cannot be called; give a subclass of SubstepHook"),
        ({"state_reader": 3}, "state_reader=3; give a subclass of StateReader"),
        ({"reward_schedule": {"gate": float}}, "reward_schedule names 'gate', which is no reward term"),
        ({"reward_schedule": {"gait": 2.0}}, "the reward_schedule of 'gait' is 2.0; give a function"),
    ],
)
def test_a_field_of_another_kind_is_named(fields, message):
    with pytest.raises(InputError, match=message):
        WALKING.replace(**fields)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"names": "speed"}, "names='speed' of a command; give a tuple of texts"),
        ({"units": ("m/s",)}, "have 1 units; give 2"),
        ({"names": (), "units": ()}, r"names=\(\) of a command"),
        ({"grid": 3}, "grid=3: give a CommandGrid"),
    ],
)
def test_a_command_whose_components_have_no_names_or_units_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(WALKING.command, **arguments)


@pytest.mark.parametrize("task", [riding, walking])
def test_rewards_that_are_no_mapping_are_refused_by_every_task(task):
    with pytest.raises(InputError, match="give a mapping of names to RewardTerm"):
        task(rewards=None)


def test_a_disturbance_that_cannot_be_called_is_refused_where_it_is_written():
    with pytest.raises(InputError, match="function=3 of a disturbance cannot be called"):
        Disturbance(3, 1.0)


@pytest.mark.parametrize("arguments", [{"steering_weight_peak": "x"}, {"steering_weight_peak_at": 0.0}])
def test_an_impossible_steering_weight_is_named(arguments):
    with pytest.raises(InputError, match=next(iter(arguments))):
        riding(**arguments)


def test_a_registered_function_that_returns_no_task_is_named(monkeypatch):
    monkeypatch.setitem(TASKS._entries, "nothing", lambda: None)
    with pytest.raises(InputError, match="the task 'nothing'=None: give a function that returns a Task"):
        make_task("nothing")


def test_a_command_has_as_many_components_as_names():
    assert len(CommandSpace(("x", "y", "yaw"), ("m", "m", "rad"))) == 3

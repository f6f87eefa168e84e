"""A task's fields are checked where it is written: what is wrong is named, with what to give."""

from __future__ import annotations

import dataclasses
from functools import partial

import pytest
import torch

from torchrl_atr._errors import InputError
from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.physics import SubstepHook
from torchrl_atr.envs.tasks import TASKS, CommandSpace, Disturbance, make_task, riding, walking
from torchrl_atr.envs.tasks.events import push_robot, stand
from torchrl_atr.envs.tasks.riding.drive_law import DriveHook
from torchrl_atr.envs.tasks.riding.state import RidingStateExtractor

WALKING = walking("a1")


def make(task):
    return QuadrupedEnv(task, num_envs=2, num_threads=1, seed=0)


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
        ({"tracking_rewards": "forward_command"}, "tracking_rewards='forward_command'; give a list"),
        ({"interpretation": "literal"}, "interpretation='literal'; give Interpretation"),
        ({"reset": 3}, "reset=3 cannot be called"),
        ({"substep_hook": 3}, "substep_hook=3 cannot be called; give a subclass of SubstepHook"),
        ({"state_extractor": 3}, "state_extractor=3; give a subclass of StateExtractor"),
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


def test_steadiness_and_the_weight_of_a_fall_are_the_learners_alone():
    task = riding(steadiness=0.5, fall_weight=7.0)
    assert task.rewards == riding().rewards
    assert {name: factor(0.3) for name, factor in task.reward_schedule.items()} == {
        "height_maintenance": 5.5,
        "body_orientation": 3.0,
        "body_velocity": 250.5,
        "postural_deviation": 10.5,
        "termination": 7.0,
    }
    assert not riding().reward_schedule
    few = {name: riding().rewards[name] for name in ("forward_command", "steering_command", "body_orientation")}
    assert set(riding(rewards=few, steadiness=1.0).reward_schedule) == {"body_orientation"}


def test_feet_that_slide_cost_what_is_asked_and_nothing_by_default():
    added = {name: term for name, term in riding(slip_weight=20.0).rewards.items() if name not in riding().rewards}
    assert {name: term.weight for name, term in added.items()} == {"foot_slip": -20.0}
    assert "foot_slip" not in riding().rewards


@pytest.mark.parametrize(
    "arguments",
    [
        {"slip_weight": -1.0},
        {"steering_weight_peak": "x"},
        {"steering_weight_peak_at": 0.0},
        {"steadiness": -1.0},
        {"fall_weight": "x"},
    ],
)
def test_an_impossible_weight_of_the_learner_is_named(arguments):
    with pytest.raises(InputError, match=next(iter(arguments))):
        riding(**arguments)


def test_a_registered_function_that_returns_no_task_is_named(monkeypatch):
    monkeypatch.setitem(TASKS._entries, "nothing", lambda: None)
    with pytest.raises(InputError, match="the task 'nothing'=None: give a function that returns a Task"):
        make_task("nothing")


def test_a_command_has_as_many_components_as_names():
    assert len(CommandSpace(("x", "y", "yaw"), ("m", "m", "rad"))) == 3


def standing(scene, command, generator, **fields):
    return stand(scene, command, generator)._replace(**fields)


@pytest.mark.parametrize(
    ("reset", "message"),
    [
        (lambda scene, command, generator: None, "reset returned NoneType; return an InitialState"),
        (partial(standing, qpos=torch.zeros(2, 3)), r"reset returned qpos of \(2, 3\) .*must be floats of \(2, 19\)"),
        (partial(standing, qvel=[0.0]), r"reset returned qvel of list; it must be floats of \(2, 18\)"),
        (partial(standing, moving=torch.zeros(2)), r"moving of \(2,\) of torch.float32; it must be bool of \(2,\)"),
    ],
)
def test_a_reset_that_returns_something_else_is_named(reset, message):
    with pytest.raises(InputError, match=f"task 'walking': .*{message}"):
        make(WALKING.replace(reset=reset))


def test_a_disturbance_that_fails_is_named():
    env = make(WALKING.replace(disturbances={"gust": Disturbance(lambda engine, rows: None, 0.02)}))
    with pytest.raises(InputError, match="the disturbance 'gust' failed: TypeError"):
        env.rollout(3)


def forgetful(engine):
    hook = SubstepHook(engine)
    del hook.state
    return hook


def clashing(engine):
    hook = SubstepHook(engine)
    hook.state = {"qpos": torch.zeros(2, 1)}
    return hook


def short(engine):
    hook = SubstepHook(engine)
    hook.state = {"clock": torch.zeros(1)}
    return hook


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"substep_hook": lambda engine: 3}, "hook made 3 of an engine; give a subclass of SubstepHook"),
        ({"substep_hook": forgetful}, r"SubstepHook has no state; call super\(\).__init__\(engine\)"),
        ({"substep_hook": clashing}, "calls an entry of its state 'qpos', as the engine does"),
        ({"substep_hook": short}, "its state 'clock' must be a tensor of 2 rows"),
        ({"substep_hook": DriveHook}, "riding needs a Transporter to stand on, not 'flat_ground'"),
        ({"state_extractor": RidingStateExtractor}, "a RidingState needs substep_hook=DriveHook, not SubstepHook"),
        ({"memory": {**WALKING.memory, "steps": WALKING.memory["phase"]}}, "the memory term 'steps' has the name of"),
        ({"memory": {**WALKING.memory, "qpos": WALKING.memory["phase"]}}, "the memory term 'qpos' has the name of"),
    ],
)
def test_a_hook_or_a_name_that_breaks_the_state_is_refused(fields, message):
    with pytest.raises(InputError, match=message):
        make(WALKING.replace(**fields))

"""Rides through a sequence of commands: what is in force when, and what counts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchrl_atr._errors import InputError
from torchrl_atr.evaluation.sequence import evaluate_sequence

from .conftest import policy_of, puppet_env, puppet_speeds

COMMANDS = [(0.0, 0.5, 0.0), (0.3, -0.5, 0.25)]


def run(function, seconds=0.6, robots=2, **options):
    return evaluate_sequence(
        policy_of(function), puppet_env, COMMANDS, seconds, robots, speeds=puppet_speeds, dt=0.1, **options
    )


def test_each_command_is_in_force_from_its_own_second_on():
    told = []
    result = run(lambda command: command.clone(), progress=lambda done, total: told.append((done, total)))
    assert result.asked.tolist() == [[0.5, 0.0]] * 3 + [[-0.5, 0.25]] * 3
    np.testing.assert_array_equal(result.command, np.repeat(result.asked[:, None], 2, 1))
    np.testing.assert_array_equal(result.achieved, result.command)  # the puppet does what it is told
    assert result.survived.all()
    assert result.estimated is None
    assert told[-1] == (6, 6)


def test_a_robot_that_fell_stays_down():
    steps = iter(range(6))

    def fall_in_the_third(command):
        return command.clone() if next(steps) != 2 else torch.full_like(command, torch.nan)

    assert run(fall_in_the_third).up[:, 0].tolist() == [True] * 3 + [False] * 3


def test_a_ride_without_a_step_is_refused():
    with pytest.raises(InputError, match=r"a ride lasts 0.1 s or more"):
        run(lambda command: command, seconds=0.0)

"""Walking's reward terms by their closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchrl_atr.envs.tasks import RewardTerm, walking
from torchrl_atr.envs.tasks.walking.rewards import EFFORT_AT_FIRST, WALKING_REWARDS, effort_schedule

Q0 = torch.tensor(walking().robot.q0)
BENT = Q0 + 0.1
"""Every joint 0.1 rad from q0."""
ONE_FOOT_UP = [[0.0, 0.0, 30.0]] * 3 + [[0.0] * 3]
SLIDING = [[3.0, 4.0, 9.0]] * 4


@pytest.mark.parametrize(
    ("name", "given", "value"),
    [
        ("forward_command", {"command": (1.0, 0.0), "speeds": [1.0, 0.7]}, 1.0),
        ("forward_command", {"command": (1.0, 0.0), "speeds": [0.5, 0.0]}, math.exp(-1.0)),
        ("turning_command", {"command": (0.0, -0.5), "speeds": [2.0, 0.5]}, math.exp(-2.0)),
        ("speed_error", {"command": (1.0, 0.0), "speeds": [-0.5, 0.0]}, 1.5),
        ("lateral_speed", {"lateral_speed": -0.3}, 0.09),
        ("vertical_speed", {"velocity": [1.0, 1.0, -0.2]}, 0.04),
        ("rolling_and_pitching", {"angular_velocity": [0.3, 0.4, 5.0]}, 0.25),
        ("orientation", {"euler": [0.3, -0.4, 2.0]}, 0.25),
        ("height", {"height": walking().robot.standing_height - 0.1}, 0.01),
        ("joint_torque", {"torque": [2.0] * 12}, 48.0),
        ("joint_power", {"torque": [2.0, -2.0, 2.0] * 4, "torque_velocity": [3.0, 3.0, -3.0] * 4}, 24.0),
        ("joint_acceleration", {"joint_acceleration": [10.0] * 12}, 1200.0),
        ("action_rate", {"action": 0.5}, 3.0),
        ("abduction", {"joint_position": BENT}, 0.04),
        ("posture", {"joint_position": BENT}, 0.12),
        ("standing_posture", {"joint_position": BENT}, 0.12),
        ("standing_posture", {"joint_position": BENT, "command": (0.5, 0.0)}, 0.0),
        ("standing_feet", {"foot_force": ONE_FOOT_UP}, 1.0),
        ("standing_feet", {"foot_force": ONE_FOOT_UP, "command": (0.0, 0.5)}, 0.0),
        ("slip", {"foot_velocity": SLIDING}, 100.0),
        ("slip", {"foot_velocity": SLIDING, "foot_force": ONE_FOOT_UP}, 75.0),
        ("collision", {"other_force": [0.0, 0.0, 0.9]}, 0.0),
        ("collision", {"other_force": [0.0, 0.9, 0.9]}, 1.0),
        ("termination", {"terminated": True}, 1.0),
    ],
)
def test_closed_form(walker, name, given, value):
    assert WALKING_REWARDS[name].function(walker(**given)).item() == pytest.approx(value, abs=1e-5)


def test_standing_still_when_asked_to_costs_nothing(walker):
    earned = {name: term.function(walker()).item() for name, term in WALKING_REWARDS.items()}
    assert {name for name, value in earned.items() if abs(value) > 1e-9} == {
        "forward_command",
        "turning_command",
        "gait",
    }
    assert all(earned[name] == 1.0 for name in ("forward_command", "turning_command", "gait"))


def test_penalties_of_effort_grow_over_the_first_half_of_the_training_alone():
    schedule = effort_schedule()
    assert set(schedule) == set(EFFORT_AT_FIRST) <= set(WALKING_REWARDS)
    for name, factor in schedule.items():
        assert WALKING_REWARDS[name].weight < 0, name
        assert factor(0.0) == EFFORT_AT_FIRST[name] < 1.0
        assert factor(0.25) == pytest.approx((EFFORT_AT_FIRST[name] + 1.0) / 2)
        assert factor(0.5) == factor(0.75) == factor(1.0) == 1.0
        assert (np.diff([factor(share) for share in np.linspace(0, 1, 21)]) >= 0).all()


def test_the_schedule_is_of_the_terms_that_there_are():
    rewards = {name: term for name, term in WALKING_REWARDS.items() if name != "slip"}
    assert "slip" in walking().reward_schedule
    assert "slip" not in walking(rewards=rewards).reward_schedule
    alone = {name: WALKING_REWARDS[name] for name in ("forward_command", "turning_command")}
    assert walking(rewards={**alone, "mine": RewardTerm(torch.zeros_like, 1.0)}).reward_schedule == {}

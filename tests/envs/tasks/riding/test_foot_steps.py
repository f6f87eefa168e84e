"""Scripted steps: when feet step, where they land, and what stays the policy's."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.envs.models import ROBOTS, Transporter, build_scene, get_transporter
from torchrl_atr.envs.models.leg_kinematics import leg_kinematics
from torchrl_atr.envs.tasks.riding.foot_steps import (
    BLEND,
    CALM_TILT,
    CALM_TURNING,
    LIFT,
    REST,
    SETTLING,
    SWING,
    FootSteps,
)

PROPRIO = {"angular_velocity": 3, "orientation": 2, "joint_position": 12}
EXTRINSIC = {"relative_position": 2, "relative_yaw": 1}
STILL = torch.full((1, 12), 0.1)


@pytest.fixture(params=["a1", "spot"])
def robot(request):
    return ROBOTS.get(request.param)


@pytest.fixture
def steps(robot):
    return FootSteps(
        build_scene(robot, Transporter(get_transporter("single_board", robot))), PROPRIO, EXTRINSIC, threshold=0.05
    )


def ride(steps, robot, pose, total, action=STILL, motion=(0.0, 0.0, 0.0, 0.0, 0.0)):
    """Actions carried out while the trunk is estimated at ``pose`` and the encoders say q0, and the states."""
    proprio = torch.cat([torch.tensor(motion), torch.tensor(robot.q0)]).unsqueeze(0)
    state, actions, states = steps.start(1), [], []
    for t in range(total):
        at = torch.tensor([pose(t) if callable(pose) else pose])
        given, state = steps(action, proprio, at, state)
        actions.append(given[0])
        states.append(state[0])
    return torch.stack(actions), torch.stack(states)


def middle(steps, robot):
    """Pose of the trunk whose feet are in their places when the joints are in q0."""
    feet = leg_kinematics(robot)(torch.tensor(robot.q0)[None])[0, :, :2]
    return (*(steps._home - feet).mean(0).tolist(), 0.0)


def test_feet_in_their_places_stay_down(steps, robot):
    actions, states = ride(steps, robot, middle(steps, robot), 200)
    assert torch.equal(actions, STILL.expand(200, -1))
    assert (states[-1, 0], states[-1, 1]) == (0.0, 0.0)


def test_two_feet_swing_to_their_places_and_the_other_two_stay_the_policys(steps, robot):
    """The trunk is 8 cm ahead with its feet: they go back by 8 cm, lifted on the way."""
    x, y, yaw = middle(steps, robot)
    total = SETTLING + SWING + BLEND + REST + SWING + 2
    actions, _ = ride(steps, robot, (x + 0.08, y, yaw), total)
    legs, q0 = leg_kinematics(robot), torch.tensor(robot.q0)
    feet = legs(q0 + robot.action_scale * actions) - legs(q0 + robot.action_scale * STILL)
    first = int((actions != STILL).any(-1).nonzero()[0])
    assert first >= SETTLING - 1
    swing = slice(first, first + SWING)
    assert torch.equal(
        actions[swing].unflatten(-1, (4, 3))[:, [1, 2]], STILL.unflatten(-1, (4, 3))[:, [1, 2]].expand(SWING, -1, -1)
    )
    landing = legs(q0 + robot.action_scale * actions[first + SWING - 1])[[0, 3]] - legs(q0)[[0, 3]]
    torch.testing.assert_close(landing, torch.tensor([-0.08, 0.0, 0.0]).expand(2, 3), atol=0.015, rtol=0.0)
    heights = legs(q0 + robot.action_scale * actions[swing])[:, [0, 3], 2] - legs(q0)[[0, 3], 2]
    assert 0.7 * LIFT < heights.max() < LIFT + 0.01  # joints move straight, over 8 cm a foot does not
    back = actions[first + SWING + BLEND : first + SWING + BLEND + REST - 1]
    assert torch.equal(back, STILL.expand_as(back))  # and all four stay down for a while
    assert feet[-1, [1, 2]].norm(dim=-1).min() > 0.02  # then it is the turn of the other two


@pytest.mark.parametrize(("share", "steps_back"), [(0.75, False), (1.25, True)])
def test_feet_step_once_both_of_a_pair_have_drifted_by_the_threshold_on_average(steps, robot, share, steps_back):
    x, y, yaw = middle(steps, robot)
    _, states = ride(steps, robot, (x + share * steps.threshold, y, yaw), SETTLING + 5)
    assert bool((states[:, 0] == 1).any()) == steps_back


def test_a_cycle_by_its_steps(steps, robot):
    """A pair is lifted, returns to the policy's targets in fifths, and counts as home once its return has begun."""
    x, y, yaw = middle(steps, robot)
    actions, states = ride(steps, robot, (x + 0.08, y, yaw), SETTLING + SWING + BLEND + REST + 3)
    lifted = (states[:, 0] == 1).nonzero().flatten().tolist()
    assert lifted == [SETTLING + 1, SETTLING + SWING + BLEND + REST + 2]  # no sooner: all four rest in between
    assert states[lifted, 1].tolist() == [0.0, 1.0]
    landed, pair = lifted[0] + SWING - 1, [0, 3]
    beside = (actions[landed:] - STILL).unflatten(-1, (4, 3))[: BLEND + 1, pair]
    shares = torch.tensor([1.0, 0.8, 0.6, 0.4, 0.2, 0.0])
    torch.testing.assert_close(beside, shares[:, None, None] * beside[0])
    assert beside[0].abs().max() > 0.1
    away = (states[:, 2:10].unflatten(-1, (4, 2)) - steps._home).norm(dim=-1)[:, pair]
    assert away[landed + 1].min() > 0.05
    assert (away[landed + 2] == 0.0).all()
    assert (away[landed + 3] > 0.0).all()


def test_turned_feet_step_back_as_far_as_they_are_turned(steps, robot):
    x, y, yaw = middle(steps, robot)
    actions, _ = ride(steps, robot, (x, y, yaw + 0.4), SETTLING + SWING + 2)
    stepped = (actions[SETTLING + SWING - 1] - STILL).unflatten(-1, (4, 3)).abs().sum(-1)[0] > 0.01
    assert stepped.tolist() in ([True, False, False, True], [False, True, True, False])


@pytest.mark.parametrize("column", range(5))
def test_a_robot_that_tips_or_turns_over_lifts_no_foot(steps, robot, column):
    x, y, yaw = middle(steps, robot)
    limit = (CALM_TURNING, CALM_TURNING, 9.0, CALM_TILT, CALM_TILT)[column]
    begun = []
    for share in (-1.1, 0.9):
        motion = [0.0] * 5
        motion[column] = share * limit
        _, states = ride(steps, robot, (x + 0.15, y, yaw), SETTLING + 40, motion=tuple(motion))
        begun.append(bool((states[:, 0] == 1).any()))
    assert begun == [column == 2, True]


def test_an_estimate_that_is_wrong_for_a_moment_costs_no_step(steps, robot):
    x, y, yaw = middle(steps, robot)
    actions, _ = ride(steps, robot, lambda t: (x + 0.15 * (t in (40, 41)), y, yaw), 80)
    assert torch.equal(actions, STILL.expand(80, -1))


def test_an_episode_begins_with_its_own_places(steps, robot):
    """The state before it, whatever it was, is gone."""
    x, y, yaw = middle(steps, robot)
    _, states = ride(steps, robot, (x + 0.08, y, yaw), 30)
    mixed = torch.stack([states[-1], steps.start(1)[0]])
    proprio = torch.cat([torch.zeros(5), torch.tensor(robot.q0)]).expand(2, -1)
    _, after = steps(STILL.expand(2, -1), proprio, torch.tensor([[x, y, yaw]] * 2), mixed)
    torch.testing.assert_close(after[1, 2:10].unflatten(-1, (4, 2)), steps._home, atol=0.03, rtol=0.0)
    assert not torch.allclose(after[0, 2:10], after[1, 2:10], atol=0.01)

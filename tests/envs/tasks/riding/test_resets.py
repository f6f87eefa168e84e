"""Early termination: each limit from both sides (A34)."""

from __future__ import annotations

import math

import pytest
import torch

from torchrl_atr.envs.interpretation import get_interpretation
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks import StepContext
from torchrl_atr.envs.tasks.riding import TERMINATIONS
from torchrl_atr.envs.tasks.riding.resets import DISPLACEMENT, TURN, start


def ended(context: StepContext) -> list[str]:
    """Return which terminations hold."""
    return [name for name, termination in TERMINATIONS.items() if termination(context).item()]


@pytest.mark.parametrize(
    ("situation", "ends"),
    [
        ({}, []),
        ({"euler": [0.99, 0.0, 0.0]}, []),
        ({"euler": [1.01, 0.0, 0.0]}, ["tilted"]),
        ({"euler": [0.0, -1.01, 0.0]}, ["tilted"]),
        ({"euler": [0.0, 0.0, 3.0]}, []),
        ({"position": [0.44, 0.0, 0.455]}, []),
        ({"position": [0.46, 0.0, 0.455]}, ["off_the_boards"]),
        ({"position": [0.0, -0.34, 0.455]}, []),
        ({"position": [0.0, -0.36, 0.455]}, ["off_the_boards"]),
        # the deck's length lies along y after a quarter turn
        ({"position": [0.0, 0.40, 0.455], "platform_euler": [0.0, 0.0, math.pi / 2]}, []),
        ({"position": [0.40, 0.0, 0.455], "platform_euler": [0.0, 0.0, math.pi / 2]}, ["off_the_boards"]),
        ({"position": [5.2, 0.0, 0.455], "platform_position": [5.0, 0.0, 0.15]}, []),
        ({"position": [0.0, 0.0, 0.15 + 0.025 + 0.15]}, []),
        ({"position": [0.0, 0.0, 0.15 + 0.025 + 0.13]}, ["too_low"]),
    ],
)
def test_limits(make_context, situation, ends):
    assert ended(make_context(**situation)) == ends


@pytest.mark.parametrize(("name", "value"), [("root_qpos", math.nan), ("joint_dof", math.inf)])
def test_a_state_that_is_no_number_ends_the_episode_too(name, value):
    env = RidingEnv(num_envs=2, num_threads=1, seed=0)
    runner, layout = env.runner, env.scene.layout
    snapshot = runner.terms.extractor.gather()
    column = layout.root_qpos + 1 if name == "root_qpos" else layout.joint_dof[0]
    snapshot["qpos" if name == "root_qpos" else "qvel"][1, column] = value
    idle, still = torch.zeros(2, 12), torch.zeros(2, dtype=torch.bool)
    before = runner.terms.extractor.differentiated, idle, idle, runner.memory
    outcome, *_ = runner.terms.evaluate(snapshot, *before, torch.zeros(2, 2), runner.x_int, still, {})
    assert outcome.terminated.tolist() == [False, True]
    assert not outcome.finite


def test_the_tilt_limit_is_a_reading(make_context):
    assert ended(make_context(euler=[0.0, 0.9, 0.0])) == []
    assert ended(make_context(euler=[0.0, 0.9, 0.0], interpretation=get_interpretation("legged_gym"))) == ["tilted"]


def test_displaced_robots_stand_shifted_and_turned_within_the_declared_bounds():
    env = RidingEnv(num_envs=400, num_threads=1, seed=0, displaced_start=0.5, randomization="off")
    state = env.runner.terms.extractor.read()
    nominal = RidingEnv(num_envs=1, num_threads=1, seed=0, randomization="off").runner.terms.extractor.read()
    moved = (state.relative_position - nominal.relative_position).abs()
    turned = state.relative_yaw[:, 0].abs()
    assert (turned > 1e-6).float().mean().item() == pytest.approx(0.5, abs=0.08)
    assert 0.9 * TURN < turned.max() <= TURN
    bounds = torch.tensor(DISPLACEMENT)
    lever = nominal.relative_position.norm() * TURN  # the robot's frame is turned about the middle of the boards
    assert (moved <= bounds + lever + 1e-6).all()
    assert (moved.amax(0) > 0.9 * bounds).all()
    assert state.contacts.shape == (400, 4)
    td = env.rollout(25, break_when_any_done=False)
    assert td["next", "terminated"].float().mean() < 0.01


def test_a_displaced_robot_that_moves_moves_with_the_board():
    env = RidingEnv(num_envs=64, num_threads=1, seed=0, displaced_start=1.0, moving_start=1.0)
    env.reset(env.full_state_spec.zero().set("command", torch.tensor([[2.0, 1.0]]).expand(64, 2).clone()))
    state = env.runner.terms.extractor.read()
    arm = state.position[:, :2] - state.platform_position[:, :2]
    rigid = state.platform_velocity[:, :2] + state.speeds[:, 1:] * torch.stack([-arm[:, 1], arm[:, 0]], -1)
    torch.testing.assert_close(state.velocity[:, :2], rigid, atol=1e-4, rtol=0)


def test_a_robot_that_starts_on_the_move_turns_about_the_vertical_as_the_board_does(scene):
    generator, command = torch.Generator().manual_seed(0), torch.tensor([[2.0, 1.0], [2.0, -1.0]])
    qvel, root = start(moving=1.0)(scene, command, generator).qvel, scene.layout.root_dof
    board = qvel[:, scene.support_layout.planar_dof[2]]
    assert board.sign().tolist() == [1.0, -1.0]
    assert torch.equal(qvel[:, root + 3 : root + 6], torch.stack([0.0 * board, 0.0 * board, board], -1))


@pytest.mark.parametrize("robot", ["a1", "go1", "anymal_c", "spot"])
def test_a_robot_of_nominal_masses_starts_balanced_with_its_centre_of_mass_over_the_pivot(robot):
    env = RidingEnv(robot, "two_board", num_envs=4, seed=0, num_threads=1, randomization="off")
    env.reset()
    state = env.runner.terms.extractor.read()
    assert (state.com - state.platform_position)[:, :2].norm(dim=-1).max() < 2e-3
    if robot == "spot":  # whose trunk's origin is elsewhere: r2 of the origin (A40) charges 1 a second for balance
        assert (state.position - state.platform_position)[:, 0].min() > 0.03

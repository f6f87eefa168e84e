"""Tilt of what a robot stands on: closed forms, and the boards of the simulation."""

from __future__ import annotations

import math

import pytest
import torch

from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.tasks import riding
from torchrl_atr.envs.tasks.rotations import matrix_from_euler
from torchrl_atr.envs.tasks.support_tilt import NAME, feet_tilt

FEET = torch.tensor([[0.2, -0.15, 0.0], [-0.2, -0.15, 0.0], [0.2, 0.15, 0.0], [-0.2, 0.15, 0.0]])
"""Front right, rear right, front left, rear left; m."""


def tilted(roll: float, pitch: float) -> torch.Tensor:
    return matrix_from_euler(*torch.tensor([roll, pitch, 0.0]).unsqueeze(-1))[0]


@pytest.mark.parametrize(("roll", "pitch"), [(0.1, 0.0), (0.0, 0.2), (0.0, -0.2)])
def test_the_tilt_of_a_board_is_that_of_the_feet_however_the_trunk_leans(roll, pitch):
    trunk = torch.tensor([[0.07, -0.12]])
    world = (FEET - torch.tensor([0.01, 0.0, 0.3])) @ tilted(roll, pitch).T
    feet = world @ tilted(*trunk[0].tolist())  # in the trunk's frame
    torch.testing.assert_close(feet_tilt(feet[None], trunk), torch.tensor([[roll, pitch, 0.0]]), atol=1e-6, rtol=0)


def test_boards_of_different_pitch_twist():
    feet = FEET.clone()
    feet[0, 2], feet[2, 2] = -0.4 * math.tan(0.1), -0.4 * math.tan(0.02)  # right and left front feet
    _, pitch, twist = feet_tilt(feet[None], torch.zeros(1, 2))[0].tolist()
    assert twist == pytest.approx(0.04)
    assert pitch == pytest.approx(0.06, abs=1e-3)


@pytest.mark.parametrize("pair", [("a1", "single_board"), ("go1", "two_board")])
def test_a_standing_robot_observes_what_drives_its_transporter(pair):
    env = QuadrupedEnv(riding(*pair, observe_tilt=True, pushes=False), num_envs=16, num_threads=1, seed=0)
    td, lean = env.reset(), 0.3 * torch.randn(16, 1, generator=torch.Generator().manual_seed(0))
    for _ in range(25):
        td["action"] = lean * torch.tensor([0.0, 1.0, 0.0]).repeat(4)
        td = env.step(td)["next"]
    state = env.runner.terms.extractor.read()
    standing = state.contacts.bool().all(-1)
    names = env.runner.terms.observations.names("proprio")
    roll, pitch, twist = td["proprio"][:, names.index(f"{NAME}[0]") :][:, :3].unbind(-1)
    forward, steering = state.driving_tilt[standing].float().unbind(-1)
    seen = roll if pair[1] == "single_board" else twist
    assert standing.sum() > 8
    assert forward.std() > 0.02
    torch.testing.assert_close(pitch[standing], forward, atol=4e-3, rtol=0)
    torch.testing.assert_close(seen[standing], steering, atol=8e-3, rtol=0)


def test_the_observation_is_mirrored():
    env = QuadrupedEnv(riding(observe_tilt=True), num_envs=1, num_threads=1)
    names = env.runner.terms.observations.names("proprio")
    assert env.reflections["proprio"].diagonal()[names.index(f"{NAME}[0]") :].tolist() == [-1.0, 1.0, -1.0]

"""A skateboard, steered by roll alone, is an entry that a user adds: its boards, hinge and drive law."""

from __future__ import annotations

import math

import pytest
import torch

from torchrl_atr.envs import RidingEnv
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models import (
    Board,
    Hinge,
    TransporterDesign,
    TransporterError,
    TransporterSpec,
    read_transporter,
)


def test_it_turns_by_roll_and_speed_as_its_trucks_do(skateboard):
    env = RidingEnv("a1", "skateboard", num_envs=4, randomization="off", pushes=False, seed=0)
    hook, hinge = env.engine.hook, env.scene.support_layout
    speed, rolls = 1.0, torch.tensor([-0.1, 0.0, 0.05, 0.1], dtype=torch.float64)
    hook.speeds[:, 0], hook.speeds[:, 1] = speed, 0.0
    for _ in range(400):  # the law alone, with the board held at these angles and this speed
        env.engine.qpos[:, hinge.tilt_qpos[0]], hook.speeds[:, 0] = rolls, speed
        hook.apply(0.005)
    wanted = speed * torch.tan(-skateboard.STEERING * rolls) / skateboard.WHEELBASE
    drag = 0.05 + 0.2 / 0.5  # of the resistance about rest, 1/s, against 10 of the trucks
    torch.testing.assert_close(hook.speeds[:, 1], wanted / (1 + 0.1 * drag), atol=2e-3, rtol=0)


@pytest.mark.usefixtures("skateboard")
def test_a_robot_rolls_along_on_it_and_nothing_else_drives_it():
    env = RidingEnv("a1", "skateboard", num_envs=2, randomization="off", pushes=False, seed=0)
    td = env.reset()
    for _ in range(50):
        td = env.step(td.set("action", torch.zeros(2, 12)))["next"]
    assert not td["terminated"].any()
    assert td["speeds"][:, 0].abs().max() == 0.0  # no tilt drives it forward
    assert td["privileged", "intrinsic"].shape == (2, 34)
    assert torch.equal(env.reflections["speeds"], torch.diag(torch.tensor([1.0, -1.0])))


def test_a_file_may_name_its_design(skateboard, tmp_path):
    path = tmp_path / "board.toml"
    path.write_text('name = "long"\ndesign = "skateboard"\nsize = [1.0, 0.6, 0.05]\nmass = 6.0\n')
    assert read_transporter(path).design is skateboard.SKATEBOARD


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"boards": (Board("deck", 0.0, 1.0, ()),)}, "needs a hinge"),
        ({"driving": ((1.0, 0.0), (0.0, 1.0))}, r"driving of a design has shape \(2, 2\); with 1 hinges"),
        ({"drive": "fast"}, "drive='fast' of a design cannot be called"),
    ],
)
def test_a_design_that_is_none_is_named(change, message):
    roll = Hinge("roll", (1.0, 0.0, 0.0), 0)
    parts = {"boards": (Board("deck", 0.0, 1.0, (roll,)),), "driving": ((0.0,), (1.0,)), "attitude": ((0.0,), (1.0,))}
    with pytest.raises(TransporterError, match=message):
        TransporterDesign(**{**parts, **change})


def test_its_drive_is_a_function_of_tilt_and_speeds(skateboard):
    spec = TransporterSpec("s", skateboard.SKATEBOARD, (0.9, 0.5, 0.05), 5.0)
    tilt, speeds = torch.tensor([[0.0, -0.2]], dtype=torch.float64), torch.tensor([[2.0, 0.1]], dtype=torch.float64)
    push = skateboard.skate(tilt, speeds, spec, Interpretation())
    assert push[0].tolist() == pytest.approx([0.0, (2.0 * math.tan(0.16) / 0.6 - 0.1) / 0.1])

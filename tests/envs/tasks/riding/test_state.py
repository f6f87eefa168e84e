"""A transporter that turned many times: observations are those of the same heading within one turn."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.envs import RidingEnv


def turned(env: RidingEnv, heading: float, turns: int) -> None:
    """Turns board and robot to ``heading``, and the board's joint by whole turns more."""
    layout, support, state = env.scene.layout, env.scene.support_layout, env.get_state()
    qpos, root = state["qpos"], layout.root_qpos
    qpos[:, support.planar_qpos[2]] = heading + turns * math.tau
    c, s = math.cos(heading / 2), math.sin(heading / 2)
    w, x, y, z = qpos[:, root + 3 : root + 7].clone().unbind(-1)
    qpos[:, root + 3 : root + 7] = torch.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], -1)
    env.set_state(state)


@pytest.mark.parametrize("heading", [0.3, -3.0])
@pytest.mark.parametrize(("physics", "num_envs"), [("batch", 3), ("dm_control", 1)])
def test_whole_turns_do_not_show(physics, num_envs, heading):
    rides = []
    for turns in (0, 100_000, -100_000):
        env = RidingEnv(num_envs=num_envs, physics=physics, seed=0, num_threads=1, pushes=False)
        turned(env, heading, turns)
        env.set_state(env.get_state().exclude("emitted"))
        steps = [TensorDict(env.runner.observe(torch.zeros(num_envs, 2)), [num_envs])]
        generator = torch.Generator().manual_seed(0)
        for _ in range(10):
            action = 0.3 * torch.randn(num_envs, 12, generator=generator)
            steps.append(env.step(TensorDict({"action": action}, [num_envs]))["next"].select(*steps[0].keys()))
        rides.append(torch.stack(steps))
    for key in rides[0].keys(True, True):
        for other in rides[1:]:
            torch.testing.assert_close(other[key], rides[0][key], atol=2e-4, rtol=1e-4, msg=str(key))
    start = rides[0]["privileged", "extrinsic"][0, :, 15]
    assert start.abs().max() < 1e-4  # the relative yaw


def test_whole_turns_do_not_show_in_the_suite():
    from torchrl_atr.envs import suite

    seen = []
    for turns in (0, 100_000):
        environment = suite.load(random=0, pushes=False)
        environment.reset()
        support = environment.task.runner.scene.support_layout
        environment.physics.data.qpos[support.planar_qpos[2]] += turns * math.tau
        seen.append(environment.step(np.zeros(12)).observation)
    for name, value in seen[0].items():
        np.testing.assert_allclose(seen[1][name], value, atol=2e-4, err_msg=name)


@pytest.mark.parametrize("transporter", ["single_board", "two_board"])
def test_feet_slip_by_what_they_move_over_the_boards_alone(transporter):
    env = RidingEnv("a1", transporter, num_envs=2, seed=0, num_threads=1, pushes=False)
    extractor, planar = env.runner.terms.extractor, env.scene.support_layout.planar_qpos
    feet, moving = env.scene.layout.sensors["foot_position"], env.scene.support_layout.planar_dof
    before = extractor.gather()
    before["qvel"].zero_()
    _, places = extractor.interpret(before, None)
    # 20 ms later board and feet have turned and moved, but foot FR, which slid by 6 mm; the board has 2 m/s by then, so
    # the sensors, which are 5 ms old, show the feet 10 mm behind it
    after, turn = {name: value.clone() for name, value in before.items()}, 0.3
    c, s = math.cos(turn), math.sin(turn)
    rotation = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    pivot = rotation[:2, :2] @ before["qpos"][:, planar[:2]].mT
    after["qpos"][:, planar[:2]] = pivot.mT + torch.tensor([0.4, -0.2])
    after["qpos"][:, planar[2]] += turn
    after["qvel"][:, moving[0]] = 2.0
    points = before["sensed"][:, feet].unflatten(-1, (-1, 3)) @ rotation.T + torch.tensor([0.39, -0.2, 0.0])
    points[:, 0] += rotation @ torch.tensor([0.0, 0.006, 0.0])
    after["sensed"][:, feet] = points.flatten(-2)
    slip = extractor.interpret(after, places)[0].foot_slip
    torch.testing.assert_close(slip, torch.tensor([[0.3, 0.0, 0.0, 0.0]]).expand(2, 4), atol=1e-4, rtol=0)


def test_a_start_at_speed_is_no_slip():
    slips = []
    for speed in (0.0, 5.0):
        env = RidingEnv(num_envs=1, seed=0, num_threads=1, pushes=False, randomization="off", slip_weight=50.0)
        td, state = env.reset(), env.get_state().exclude("foot_places")
        for forward in (env.scene.layout.root_dof, env.scene.support_layout.planar_dof[0]):
            state["qvel"][:, forward] = speed
        state["speeds"][:, 0] = speed
        env.set_state(state)
        slips.append(env.step(td.set("action", torch.zeros(1, 12)))["next", "reward_terms", "foot_slip"].item())
    assert slips[1] == pytest.approx(slips[0], abs=0.1)  # 5 ms of it would be 1.25 m/s of each foot


def test_within_a_turn_headings_keep_every_bit_of_float32():
    env = RidingEnv(num_envs=1001, seed=0, num_threads=1)
    extractor, column = env.runner.terms.extractor, env.scene.support_layout.planar_qpos[2]
    angles = torch.linspace(-math.pi, math.pi, 1001, dtype=torch.float64)
    env.engine.qpos[:, column] = angles
    assert torch.equal(extractor.gather()["qpos"][:, column], angles.float())
    env.engine.qpos[:, column] = 1e5 * math.tau + angles
    far = extractor.gather()["qpos"][:, column].double()
    torch.testing.assert_close(far.sin(), angles.sin(), atol=1e-6, rtol=0)
    assert far.abs().max() <= math.pi + 1e-6

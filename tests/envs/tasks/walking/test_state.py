"""Speeds, heights and foot velocities of robots in known places."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.tasks import walking

STILL = TensorDict({"action": torch.zeros(2, 12)}, [2])


@pytest.fixture(scope="module")
def env():
    """Two robots without disturbance or randomisation; tests begin it anew."""
    return QuadrupedEnv(walking("a1", pushes=False), 2, randomization="off", seed=0, num_threads=1)


def read(env):
    """The state as it is now, without a change to the differences."""
    extractor = env.runner.terms.extractor
    return extractor.interpret(extractor.gather(), extractor.differentiated)[0]


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, -math.pi / 2, 2.5])
def test_speeds_are_those_of_the_frame_that_turns_with_the_robot(env, yaw):
    env.reset()
    layout, qpos, qvel = env.scene.layout, env.engine.qpos, env.engine.qvel
    root, dof = layout.root_qpos, layout.root_dof
    qpos[:, root + 3 : root + 7] = torch.tensor([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)], dtype=torch.float64)
    forward, left = 0.8, -0.3
    qvel[:, dof] = forward * math.cos(yaw) - left * math.sin(yaw)
    qvel[:, dof + 1] = forward * math.sin(yaw) + left * math.cos(yaw)
    qvel[:, dof + 5] = 0.6
    state = read(env)
    torch.testing.assert_close(state.speeds, torch.tensor([[forward, 0.6]] * 2), atol=1e-5, rtol=0)
    torch.testing.assert_close(state.lateral_speed, torch.full((2,), left), atol=1e-5, rtol=0)


def test_a_robot_that_leans_turns_about_the_vertical(env):
    """Rolled by 0.5 rad, turning about its own z axis at 1 rad/s: cos(0.5) of it is yaw."""
    env.reset()
    root, dof = env.scene.layout.root_qpos, env.scene.layout.root_dof
    env.engine.qpos[:, root + 3 : root + 7] = torch.tensor([math.cos(0.25), math.sin(0.25), 0.0, 0.0]).double()
    env.engine.qvel[:, dof + 3 : dof + 6] = torch.tensor([0.0, 0.0, 1.0]).double()
    torch.testing.assert_close(read(env).speeds[:, 1], torch.full((2,), math.cos(0.5)), atol=1e-5, rtol=0)


def test_heights_are_those_above_the_ground_and_above_the_stand(env):
    env.reset()
    layout = env.scene.layout
    stand = torch.from_numpy(env.model.key("stand").qpos)
    env.engine.reset(torch.arange(2), stand.expand(2, -1), torch.zeros(2, env.model.nv, dtype=torch.float64))
    env.engine.qpos[1, layout.root_qpos + 2] += 0.1
    env.engine.forward()
    state = read(env)
    standing = float(stand[layout.root_qpos + 2])
    torch.testing.assert_close(state.height, torch.tensor([standing, standing + 0.1]), atol=1e-5, rtol=0)
    torch.testing.assert_close(state.foot_height, torch.tensor([[0.0] * 4, [0.1] * 4]), atol=1e-5, rtol=0)


@pytest.mark.parametrize("walked", [0.0, 100.0])
def test_feet_that_stand_do_not_move_while_the_body_does_and_the_simulation_is_recentred(env, walked):
    """A shove of 0.4 m/s: the body sways over its feet, balls of 2 cm that roll, and the origin moves after it."""
    env.reset()
    for _ in range(25):
        env.step(STILL.clone())
    env.engine.world_offset[:] = torch.tensor([walked, -walked], dtype=torch.float64)
    env.runner.terms.extractor.forget()
    dof = env.scene.layout.root_dof
    env.engine.qvel[:, dof] += 0.4
    before, fastest = env.engine.world_offset.clone(), 0.0
    for _ in range(8):
        extractor = env.runner.terms.extractor
        previous = extractor.differentiated.clone()
        env.step(STILL.clone())
        state, _ = extractor.interpret(extractor.gather(), previous)
        assert (state.contacts == 1).all()
        assert state.foot_velocity.abs().max() < 0.06
        fastest = max(fastest, float(state.speeds[:, 0].min()))
    assert fastest > 0.3
    assert (env.engine.world_offset - before)[:, 0].abs().min() > 0.005
    assert state.position[:, :2].abs().max() < 0.1  # near the origin, wherever the robot is


def test_foot_velocities_are_blind_to_where_the_origin_is(env):
    """The same places in the world, told from an origin 100 m away: what is left is float32's rounding."""
    env.reset()
    env.step(STILL.clone())
    extractor = env.runner.terms.extractor
    here, feet = extractor.gather(), extractor._sensors["foot_position"]
    moved = {name: value.clone() for name, value in here.items()}
    moved["world_offset"] += 100.0
    moved["sensed"][:, feet].unflatten(-1, (-1, 3))[..., :2] -= 100.0
    state, _ = extractor.interpret(moved, extractor.differentiated_of(here))
    assert state.foot_velocity.abs().max() < 2e-3
    moved["sensed"][:, feet] += 0.02 * torch.tensor([1.0, -2.0, 3.0]).repeat(4)
    state, _ = extractor.interpret(moved, extractor.differentiated_of(here))
    torch.testing.assert_close(state.foot_velocity, torch.tensor([1.0, -2.0, 3.0]).expand(2, 4, 3), atol=2e-3, rtol=0)


def test_a_state_without_the_feet_s_places_starts_their_differences_anew(env):
    """As of checkpoints from before they were part of it."""
    env.reset()
    for _ in range(3):
        env.step(STILL.clone())
    state = env.get_state()
    env.set_state(state.exclude("foot_places"))
    extractor = env.runner.terms.extractor
    torch.testing.assert_close(extractor.differentiated, extractor.differentiated_of(extractor.gather()))
    env.set_state(state)
    assert torch.equal(extractor.differentiated[:, -12:], state["foot_places"])
    with pytest.raises(ValueError, match="state entry 'foot_places' has shape"):
        env.set_state(state.clone().set("foot_places", torch.zeros(2, 3)))

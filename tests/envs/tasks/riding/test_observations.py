"""Observations against quantities that MuJoCo computes for the same simulation."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from torchrl_atr.envs.interpretation import get_interpretation
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks.proprioception import body_acceleration

N = 3
SIZES = {
    "proprio": {
        "acceleration": 3,
        "angular_velocity": 3,
        "orientation": 2,
        "joint_position": 12,
        "joint_velocity": 12,
        "action": 12,
    },
    "extrinsic": {
        "contacts": 4,
        "body_velocity": 3,
        "platform_velocity": 3,
        "platform_angular_velocity": 3,
        "relative_position": 2,
        "relative_yaw": 1,
    },
}
"""Table I's components in their order."""


class Ridden:
    """An env some steps into its episodes, and what MuJoCo says about each of its simulations."""

    def __init__(self) -> None:
        self.env = RidingEnv(num_envs=N, seed=0, num_threads=1, pushes=False)
        self.env.engine.hook.speeds[:] = torch.tensor([[1.0, 0.8], [-2.0, 0.5], [0.5, -1.0]])
        generator = torch.Generator().manual_seed(0)
        td, self.actions = self.env.reset(), []
        self.env.engine.hook.speeds[:] = torch.tensor([[1.0, 0.8], [-2.0, 0.5], [0.5, -1.0]])
        for _ in range(25):
            self.before = [self.data(i) for i in range(N)]
            td["action"] = 0.3 * torch.randn(N, 12, generator=generator)
            td["command"] = torch.tensor([[0.3, -0.1]]).expand(N, 2).clone()
            self.actions.append(td["action"].clone())
            td = self.env.step(td)["next"]
        self.td = td
        self.after = [self.data(i) for i in range(N)]

    def data(self, i: int) -> mujoco.MjData:
        batch = self.env.engine.batch
        self.model = batch.get_model(i)
        data = batch.get_data(i)
        mujoco.mj_forward(self.model, data)
        return data

    def velocity(self, data: mujoco.MjData, body: str, local: bool) -> tuple[np.ndarray, np.ndarray]:
        """Angular and linear velocity of a body's frame."""
        out = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, data, mujoco.mjtObj.mjOBJ_XBODY, self.model.body(body).id, out, int(local))
        return out[:3], out[3:]

    def part(self, group: str, name: str) -> np.ndarray:
        """A named component of the emitted observation, (N, size)."""
        key = "proprio" if group == "proprio" else ("privileged", "extrinsic")
        sizes = self.env.runner.terms.observations.sizes[key]
        assert list(sizes.items()) == list(SIZES[group].items())
        start = sum(list(sizes.values())[: list(sizes).index(name)])
        return self.td[key][:, start : start + sizes[name]].numpy()


@pytest.fixture(scope="module")
def ridden():
    return Ridden()


def stacked(values) -> np.ndarray:
    return np.stack(list(values))


def test_sizes_and_composition(ridden):
    td = ridden.td
    assert td["proprio"].shape == (N, 44)
    assert td["observation"].shape == (N, 46)
    assert td["privileged", "intrinsic"].shape == (N, 34)
    assert td["privileged", "extrinsic"].shape == (N, 16)
    assert torch.equal(td["observation"], torch.cat([td["proprio"], td["command"]], -1))
    assert torch.equal(td["proprio"][:, 32:], ridden.actions[-1])


def test_the_situation_is_a_general_one(ridden):
    support = ridden.env.scene.support_layout
    assert ridden.env.engine.qpos[:, support.planar_qpos[2]].abs().min() > 0.1
    assert ridden.env.engine.qpos[:, support.tilt_qpos].abs().max() > 0.01


def test_joints_are_in_the_order_of_the_spec(ridden):
    joints = ridden.env.scene.robot.joints
    for name, field in (("joint_position", "qpos"), ("joint_velocity", "qvel")):
        expected = stacked([getattr(data.joint(joint), field)[0] for joint in joints] for data in ridden.after)
        np.testing.assert_allclose(ridden.part("proprio", name), expected, atol=1e-5)


def test_orientation_is_roll_and_pitch_of_the_trunk(ridden):
    for row, data in zip(ridden.part("proprio", "orientation"), ridden.after):
        up, forward = data.body("trunk").xmat.reshape(3, 3)[2], data.body("trunk").xmat.reshape(3, 3)[:, 0]
        np.testing.assert_allclose(row, [np.arctan2(up[1], up[2]), -np.arcsin(forward[2])], atol=1e-5)


def test_velocities_are_in_the_body_frame(ridden):
    for i, data in enumerate(ridden.after):
        angular, linear = ridden.velocity(data, "trunk", local=True)
        np.testing.assert_allclose(ridden.part("proprio", "angular_velocity")[i], angular, atol=1e-5)
        np.testing.assert_allclose(ridden.part("extrinsic", "body_velocity")[i], linear, atol=1e-5)


def test_platform_velocities_are_seen_from_the_body(ridden):
    for i, data in enumerate(ridden.after):
        to_body = data.body("trunk").xmat.reshape(3, 3).T
        angular, linear = ridden.velocity(data, "platform", local=False)
        np.testing.assert_allclose(ridden.part("extrinsic", "platform_velocity")[i], to_body @ linear, atol=1e-4)
        turning = ridden.part("extrinsic", "platform_angular_velocity")[i]
        np.testing.assert_allclose(turning, to_body @ angular, atol=1e-4)


def test_acceleration_is_the_velocity_difference_over_the_control_step(ridden):
    for i, (before, after) in enumerate(zip(ridden.before, ridden.after)):
        change = ridden.velocity(after, "trunk", local=False)[1] - ridden.velocity(before, "trunk", local=False)[1]
        expected = after.body("trunk").xmat.reshape(3, 3).T @ change / CONTROL_DT
        np.testing.assert_allclose(ridden.part("proprio", "acceleration")[i], expected, atol=1e-3)


def test_relative_pose_is_in_the_platform_frame(ridden):
    for i, data in enumerate(ridden.after):
        deck, trunk = data.body("platform"), data.body("trunk")
        offset = deck.xmat.reshape(3, 3).T @ (trunk.xpos - deck.xpos)
        np.testing.assert_allclose(ridden.part("extrinsic", "relative_position")[i], offset[:2], atol=1e-5)
        headings = [np.arctan2(body.xmat[3], body.xmat[0]) for body in (trunk, deck)]
        difference = ridden.part("extrinsic", "relative_yaw")[i, 0] - (headings[0] - headings[1])
        assert np.sin(difference / 2) == pytest.approx(0.0, abs=1e-4)


def test_contacts_and_forces_are_those_on_the_feet():
    env = RidingEnv(num_envs=1, seed=0, num_threads=1, pushes=False, randomization="off")
    for _ in range(60):
        env.engine.step(torch.tensor([env.scene.robot.q0]))
    q0 = env.scene.model.key_qpos[0]
    env.engine.qpos[0] = torch.from_numpy(q0)
    env.engine.qpos[0, env.scene.layout.root_qpos + 2] -= 1e-3
    env.engine.qpos[0, env.scene.layout.joint_qpos[4]] += 0.3  # the rear right thigh lifts its foot
    env.engine.qvel[:] = 0.0
    env.engine.forward()
    state = env.runner.terms.extractor.read()
    assert state.contacts.tolist() == [[1, 0, 1, 1]]
    assert (state.foot_force[0, [0, 2, 3], 2] > 1.0).all()  # up, on the feet
    assert state.other_force.norm() < 1e-4
    model, data = env.engine.batch.get_model(0), env.engine.batch.get_data(0)
    mujoco.mj_forward(model, data)
    for index, foot in enumerate(env.scene.robot.feet):
        np.testing.assert_allclose(state.foot_position[0, index], data.geom(foot).xpos, atol=1e-6)
    np.testing.assert_allclose(state.com[0], data.subtree_com[env.scene.layout.trunk_body], atol=1e-6)


def test_an_imu_also_feels_gravity(make_context):
    def felt_in(profile: str) -> Tensor:
        return body_acceleration(make_context(euler=[0.0, 0.5, 1.0], interpretation=get_interpretation(profile)))[0]

    assert felt_in("default").abs().max() == 0.0
    felt = felt_in("legged_gym")
    # pitched nose down by 0.5: the upward reaction has a component against the nose
    np.testing.assert_allclose(felt, [-9.81 * np.sin(0.5), 0.0, 9.81 * np.cos(0.5)], atol=1e-5)


def test_relative_yaw_is_the_short_way_round(make_state):
    state = make_state(euler=[0, 0, 3.1], platform_euler=[0, 0, -3.1])
    assert state.relative_yaw.item() == pytest.approx(6.2 - 2 * np.pi, abs=1e-5)


def test_dead_reckoning_from_rest_knows_the_bodys_velocity():
    env = RidingEnv(num_envs=16, seed=0, num_threads=1, velocity_filter="integral")  # an accelerometer feels pushes
    td, generator = env.reset(), torch.Generator().manual_seed(0)
    assert td["dead_reckoned_velocity"].abs().max() == 0.0
    up = torch.ones(16, dtype=torch.bool)
    for _ in range(200):
        td["action"] = 0.1 * torch.randn(16, 12, generator=generator)
        td = env.step(td)["next"]
        up &= ~td["terminated"].squeeze(-1)
    velocity = td["privileged", "extrinsic"][up, 4:7]
    assert up.sum() > 3
    assert velocity.norm(dim=-1).mean() > 0.5
    assert (td["dead_reckoned_velocity"][up] - velocity).norm(dim=-1).max() < 0.1


def test_a_moving_start_knows_its_velocity():
    env = RidingEnv(num_envs=8, seed=0, num_threads=1, moving_start=1.0, velocity_filter="integral")
    td = env.reset(env.full_state_spec.zero().set("command", torch.tensor([[2.0, 0.5]]).expand(8, 2).clone()))
    torch.testing.assert_close(td["dead_reckoned_velocity"], td["privileged", "extrinsic"][:, 4:7])
    assert td["dead_reckoned_velocity"].abs().amax(0)[0] > 0.5

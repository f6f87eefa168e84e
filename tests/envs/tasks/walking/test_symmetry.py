"""The mirror image of a walk is a walk."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.tasks import mirrors, walking


def mirrored(env: QuadrupedEnv, state: TensorDict) -> TensorDict:
    """The same robots in a mirror: by hand, in MuJoCo's own coordinates; the clock half a cycle later."""
    layout, out, joints = env.scene.layout, state.clone(), env.reflections["action"]
    root, dof = layout.root_qpos, layout.root_dof
    out["qpos"][:, root + 1] *= -1
    out["qpos"][:, [root + 4, root + 6]] *= -1  # of the quaternion w, x, y, z: rotations about x and z
    out["qvel"][:, [dof + 1, dof + 3, dof + 5]] *= -1
    for name, legs in (("qpos", layout.joint_qpos), ("qvel", layout.joint_dof)):
        out[name][:, legs] = state[name][:, legs] @ joints.double().T
    out["world_offset"][:, 1] *= -1
    out["phase"] = (state["phase"] + 0.5) % 1.0
    out["air_time"] = state["air_time"] @ mirrors.legs(env.scene).T
    out["dead_reckoned_velocity"] = state["dead_reckoned_velocity"] * torch.tensor(mirrors.POLAR)
    out["previous_action"] = state["previous_action"] @ joints.T
    out["x_int"] = state["x_int"] @ env.reflections["privileged", "intrinsic"].T
    shift = env.runner.intrinsics.slices["com_shift"].start + 1
    sideways = env.model.body_ipos[layout.trunk_body, 1]  # 4 mm of A1's, a fact of the robot
    out["x_int"][:, shift] -= 2 * sideways / env.task.intrinsics["com_shift"].train[1]
    return out


@pytest.mark.parametrize("robot", ["a1", "spot"])
def test_a_mirrored_walk_looks_mirrored_and_earns_the_same_term_by_term(robot):
    env, other = (QuadrupedEnv(walking(robot, pushes=False), 4, seed=seed, num_threads=1) for seed in (0, 1))
    image = env.reflections
    generator = torch.Generator().manual_seed(0)
    env.reset()
    for _ in range(3):  # so that nothing is zero
        env.step(TensorDict({"action": 0.3 * torch.randn(4, 12, generator=generator)}, [4]))
    state = env.get_state().exclude("emitted")
    state["warmstart"] = torch.zeros_like(state["warmstart"])
    state["phase"] = torch.tensor([[0.05], [0.3], [0.55], [0.8]])
    env.set_state(state)
    other.set_state(mirrored(env, state))
    command = torch.tensor([[1.0, 0.5], [0.5, -0.5], [0.0, 0.0], [0.0, 0.8]])
    for _ in range(8):
        action = 0.3 * torch.randn(4, 12, generator=generator)
        walk = env.step(TensorDict(action=action, command=command, batch_size=[4]))["next"]
        inputs = {"action": action @ image["action"].T, "command": command @ image["command"].T}
        reflected = other.step(TensorDict(inputs, batch_size=[4]))["next"]
        for key in (key for key in image if key not in ("action", ("privileged", "intrinsic"))):
            scale = walk[key].abs().max(0).values.clamp(min=1.0)
            torch.testing.assert_close(reflected[key] / scale, walk[key] @ image[key].T / scale, atol=1e-2, rtol=0)
        for name, earned in walk["reward_terms"].items():
            torch.testing.assert_close(reflected["reward_terms", name], earned, atol=1e-2, rtol=1e-2, msg=name)
    assert float(walk["observation"].std()) > 0.1
    assert float(walk["reward_terms", "gait"].std()) > 0.0


def test_clock_and_errors_by_hand():
    image = QuadrupedEnv(walking(), 1, num_threads=1).reflections
    assert image["proprio"][-2:, -2:].tolist() == [[-1, 0], [0, -1]]
    assert image["speeds"].tolist() == [[1, 0], [0, -1]]
    forecast = image["privileged", "tracking_forecast"] @ torch.arange(1.0, 13.0)
    assert forecast.tolist() == [1, -2, -3, 4, 7, 8, 5, 6, 11, 12, 9, 10]

"""The mirror image of a ride is a ride."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.envs import ROBOTS, RidingEnv
from torchrl_atr.envs.models import TRANSPORTER_DESIGNS, TRANSPORTERS, RobotError
from torchrl_atr.envs.models.transporter import TWO_BOARD, TransporterError

PAIRS = [(robot, transporter) for robot in ("a1", "go1", "anymal_c", "spot") for transporter in TRANSPORTER_DESIGNS]


def mirrored_simulation(env: RidingEnv, state: TensorDict) -> TensorDict:
    """The same robots in a mirror: by hand, in MuJoCo's own coordinates."""
    layout, support, out = env.scene.layout, env.scene.support_layout, state.clone()
    joints = env.reflections["action"].double()
    hinges = env.scene.support.spec.design.hinges
    swapped = torch.tensor([[0.0, 1.0], [1.0, 0.0]])  # right and left board
    signs = torch.diag(torch.tensor([-1.0 if hinge.axis[0] else 1.0 for hinge in hinges]))  # a roll turns round
    roll = (swapped if "right" in hinges[0].name else signs).double()
    qpos, qvel = state["qpos"].clone(), state["qvel"].clone()
    root, dof = layout.root_qpos, layout.root_dof
    qpos[:, root + 1] *= -1
    qpos[:, [root + 4, root + 6]] *= -1  # of the quaternion w, x, y, z: rotations about x and z
    qvel[:, [dof + 1, dof + 3, dof + 5]] *= -1
    for values, legs, planar, tilt in (
        (qpos, layout.joint_qpos, support.planar_qpos, support.tilt_qpos),
        (qvel, layout.joint_dof, support.planar_dof, support.tilt_dof),
    ):
        values[:, legs] = values[:, legs] @ joints.T
        values[:, planar[1:]] *= -1  # sideways, yaw
        values[:, tilt] = values[:, tilt] @ roll.T
    out["qpos"], out["qvel"] = qpos, qvel
    out["speeds"][:, 1] *= -1
    out["warmstart"] = torch.zeros_like(state["warmstart"])
    out["x_int"] = state["x_int"] @ env.reflections["privileged", "intrinsic"].T
    shift = env.runner.intrinsics.slices["com_shift"].start + 1
    sideways = env.model.body_ipos[env.scene.layout.trunk_body, 1]  # 4 mm of A1's, a fact of the robot
    out["x_int"][:, shift] -= 2 * sideways / env.task.intrinsics["com_shift"].train[1]
    return out


@pytest.mark.parametrize(("robot", "transporter"), PAIRS)
def test_a_mirrored_ride_looks_mirrored(robot, transporter):
    ride_and_reflect(robot, transporter)


@pytest.mark.usefixtures("skateboard")
def test_a_mirrored_ride_on_a_transporter_of_ones_own_looks_mirrored():
    ride_and_reflect("a1", "skateboard", speed=1.0)


def ride_and_reflect(robot: str, transporter: str, speed: float = 0.0) -> None:
    """Physics, observations, rewards: what a reflected robot does when it acts reflected, step by step."""
    env, other = (RidingEnv(robot, transporter, num_envs=4, pushes=False, seed=seed) for seed in (0, 1))
    mirror = env.reflections
    env.reset()
    other.reset()
    state = env.get_state().exclude("emitted")
    state["warmstart"] = torch.zeros_like(state["warmstart"])
    state["speeds"][:, 0] += speed
    state["qvel"][:, [env.scene.support_layout.planar_dof[0], env.scene.layout.root_dof]] += speed
    env.set_state(state)
    other.set_state(mirrored_simulation(env, state))
    generator = torch.Generator().manual_seed(0)
    for _ in range(7):  # later, a contact of a robot that is symmetric to a millimetre opens on one side first
        action, command = torch.randn(4, 12, generator=generator) * 0.2, torch.tensor([[1.0, 0.5]]).expand(4, 2)
        ride = env.step(TensorDict(action=action, command=command, batch_size=[4]))["next"]
        image = {"action": action @ mirror["action"].T, "command": command @ mirror["command"].T}
        reflected = other.step(TensorDict(image, batch_size=[4]))["next"]
        for key in (key for key in mirror if key not in ("action", ("privileged", "intrinsic"))):
            scale = ride[key].abs().max(0).values.clamp(min=1.0)
            torch.testing.assert_close(reflected[key] / scale, ride[key] @ mirror[key].T / scale, atol=1e-2, rtol=0)
        torch.testing.assert_close(reflected["reward"], ride["reward"], atol=1e-2, rtol=0)
    assert float(ride["observation"].std()) > 0.1


@pytest.mark.parametrize(("robot", "transporter"), PAIRS)
def test_reflections_undo_themselves_and_fit_the_specs(robot, transporter):
    env = RidingEnv(robot, transporter, num_envs=1)
    for key, matrix in env.reflections.items():
        assert torch.equal(matrix @ matrix, torch.eye(len(matrix))), key
        spec = env.action_spec if key == "action" else env.observation_spec[key]
        assert spec.shape[-1] == len(matrix), key


def test_left_and_right_by_hand():
    """FR, RR, FL, RL; abduction turns about x, thigh and calf about y."""
    mirror = RidingEnv(num_envs=1).reflections
    angles = torch.arange(12.0)
    assert (mirror["action"] @ angles).tolist() == [-6, 7, 8, -9, 10, 11, -0.0, 1, 2, -3, 4, 5]
    assert mirror["speeds"].tolist() == [[1, 0], [0, -1]]
    extrinsic = mirror["privileged", "extrinsic"] @ torch.arange(1.0, 17.0)
    assert extrinsic.tolist() == [3, 4, 1, 2, 5, -6, 7, 8, -9, 10, -11, 12, -13, 14, -15, -16]


def test_two_boards_swap_their_springs():
    single, two = (RidingEnv(transporter=name, num_envs=1).reflections for name in TRANSPORTER_DESIGNS)
    key = ("privileged", "intrinsic")
    springs = torch.arange(30, 34)
    assert single[key].argmax(-1)[springs].tolist() == [30, 31, 32, 33]
    assert two[key].argmax(-1)[springs].tolist() == [31, 30, 33, 32]


def test_a_lopsided_transporter_has_no_reflection():
    left = dataclasses.replace(TWO_BOARD.boards[1], offset=0.3)
    two = TRANSPORTERS.get("two_board_g1")
    lopsided = dataclasses.replace(two, design=dataclasses.replace(two.design, boards=(TWO_BOARD.boards[0], left)))
    env = RidingEnv(transporter=lopsided, num_envs=1)
    with pytest.raises(TransporterError, match=r"'deck_right' has no mirror image.*symmetric=false"):
        _ = env.reflections


def test_a_lopsided_robot_has_no_reflection():
    q0 = np.array(ROBOTS.get("a1").q0)
    q0[1] += 0.2
    lopsided = dataclasses.replace(ROBOTS.get("a1"), q0=tuple(q0))
    env = RidingEnv(lopsided, num_envs=1)
    with pytest.raises(
        RobotError, match=r"'FR_thigh_joint' is not the mirror image of 'FL_thigh_joint'.*symmetric=false"
    ):
        _ = env.reflections


LOPSIDED = {
    "masses 3.013 and 1.013 kg": ('mass="1.013"', 'mass="3.013"'),
    "centres of mass at": ('pos="-0.003237 -0.022327 -0.027326"', 'pos="-0.013237 -0.022327 -0.027326"'),
    "inertias (xx, xy, xz, yy, yz, zz)": ('fullinertia="0.00552906', 'fullinertia="0.00605'),
    "anchors at": ('<body name="FL_thigh" pos="0 0.08505 0">', '<body name="FL_thigh" pos="0.01 0.08505 0">'),
    "ranges [-1, 3] rad and [-1.047, 4.189] rad": ('class="thigh"/>', 'class="thigh" range="-1 3"/>'),
    "armature 0.02 and 0.01": ('class="thigh"/>', 'class="thigh" armature="0.02"/>'),
    "damping [0.5, 0, 0] and [0, 0, 0]": ('class="thigh"/>', 'class="thigh" damping="0.5"/>'),
    "frictionloss 0.3 and 0": ('class="thigh"/>', 'class="thigh" frictionloss="0.3"/>'),
    "stiffness [2, 0, 0] and [0, 0, 0]": ('class="thigh"/>', 'class="thigh" stiffness="2"/>'),
    "actuatorfrcrange 5 and inf": ('class="thigh"/>', 'class="thigh" actuatorfrcrange="-5 5"/>'),
    "geoms that fill": ('class="foot" pos="0 0 -0.2"', 'class="foot" pos="0 0 -0.2" size="0.025"'),
    "2 and 1 colliding geoms": ('<geom name="FL_foot"', '<geom class="foot" pos="0.01 0 -0.2"/><geom name="FL_foot"'),
}


@pytest.mark.parametrize("what", LOPSIDED)
def test_legs_that_differ_in_anything_are_named(tmp_path, what):
    a1 = ROBOTS.get("a1")
    text = a1.mjcf.read_text()
    left = text.index('<body name="FL_thigh"')
    old, new = LOPSIDED[what]
    (tmp_path / "mine.xml").write_text(text[:left] + text[left:].replace(old, new, 1))
    env = RidingEnv(dataclasses.replace(a1, mjcf=tmp_path / "mine.xml"), num_envs=1, num_threads=1)
    with pytest.raises(
        RobotError, match=f"(FL_|foot FL).* is not the mirror image of .*{re.escape(what)}.*symmetric=f"
    ):
        _ = env.reflections


def test_a_lopsided_trunk_is_named(tmp_path):
    a1 = ROBOTS.get("a1")
    text = a1.mjcf.read_text().replace('pos="0 0.0041 -0.0005"', 'pos="0 0.05 -0.0005"', 1)
    (tmp_path / "mine.xml").write_text(text)
    env = RidingEnv(dataclasses.replace(a1, mjcf=tmp_path / "mine.xml"), num_envs=1, num_threads=1)
    with pytest.raises(RobotError, match=r"left half of 'trunk'.*centre of mass is 0\.05 m to the left"):
        _ = env.reflections


def test_boards_of_unequal_springs_are_named():
    deck = dataclasses.replace(TRANSPORTERS.get("two_board_g1"), sb_stiffness=(1.0, 2.0))
    with pytest.raises(TransporterError, match=r"sb_stiffness of 'platform_pitch_right'.*symmetric=false"):
        _ = RidingEnv(transporter=deck, num_envs=1, num_threads=1).reflections

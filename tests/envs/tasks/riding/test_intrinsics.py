"""Table II: ranges, scaling, and that x_int tells the truth about the compiled simulation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS, Scene
from torchrl_atr.envs.models.scene import TIMESTEP
from torchrl_atr.envs.physics import ModelFields
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks.intrinsic_parameters import Intrinsics
from torchrl_atr.envs.tasks.riding.intrinsics import riding_intrinsics

UNIT = 180 / np.pi
# Table II in physical units (gains as ratios of a nominal 40 / 1, self-balancing gains in N m/deg): train,
# test, nominal
RANGES = {
    "payload": ((0.0, 1.0), (0.0, 3.0), 0.0),
    "com_shift": ((-0.2, 0.2), (-0.25, 0.25), 0.0),
    "kp": ((36.0, 44.0), (32.0, 48.0), 40.0),
    "kd": ((0.8, 1.2), (0.6, 1.4), 1.0),
    "platform_mass": ((11.0, 12.0), (10.5, 12.5), 11.5),
    "friction": ((0.8, 1.2), (0.7, 1.5), 1.0),
    "sb_stiffness": ((0.8 * UNIT, 1.5 * UNIT), (0.5 * UNIT, 2.0 * UNIT), 1.15 * UNIT),
    "sb_damping": ((0.02 * UNIT, 0.03 * UNIT), (0.01 * UNIT, 0.05 * UNIT), 0.025 * UNIT),
}


@pytest.fixture(scope="module")
def intrinsics(scene):
    parameters = riding_intrinsics(ROBOTS.get("a1"), TRANSPORTERS.get("single_board_g1"), Interpretation())
    return Intrinsics(parameters, scene)


def sample(intrinsics: Intrinsics, n: int, randomization: str) -> Tensor:
    return intrinsics.sample(n, randomization, torch.Generator().manual_seed(0))


def physical(intrinsics: Intrinsics, scene: Scene, x_int: Tensor) -> dict[str, Tensor]:
    """Return Table II in physical units as the model's fields have it once x_int is applied, (n, size) by name."""
    model, layout, support, n = scene.model, scene.layout, scene.support_layout, len(x_int)
    fields = ModelFields(lambda name: torch.from_numpy(np.repeat(getattr(model, name)[None], n, 0)))
    intrinsics.apply(fields, x_int)
    trunk, actuators = layout.trunk_body, layout.actuators
    return {
        "payload": fields["body_mass"][:, [trunk]] - model.body_mass[trunk],
        "com_shift": fields["body_ipos"][:, trunk] - torch.from_numpy(model.body_ipos[trunk]),
        "kp": fields["actuator_gainprm"][:, actuators, 0],
        "kd": -fields["actuator_biasprm"][:, actuators, 2],
        "platform_mass": fields["body_mass"][:, support.board_bodies],
        "friction": fields["geom_friction"][:, support.board_geoms, 0],
        "sb_stiffness": fields["jnt_stiffness"][:, support.tilt_joints],
        "sb_damping": fields["dof_damping"][:, support.tilt_dof],
    }


def test_thirty_four_components_in_the_order_of_the_table(intrinsics):
    assert list(intrinsics.slices) == list(RANGES)
    assert [s.stop - s.start for s in intrinsics.slices.values()] == [1, 3, 12, 12, 1, 1, 2, 2]
    assert sample(intrinsics, 5, "train").shape == (5, 34)


@pytest.mark.parametrize(("randomization", "column"), [("train", 0), ("test", 1)])
def test_samples_fill_the_range_of_the_table(intrinsics, scene, randomization, column):
    drawn = physical(intrinsics, scene, sample(intrinsics, 4000, randomization))
    assert list(drawn) == list(RANGES)
    for name, values in drawn.items():
        low, high = RANGES[name][column]
        assert values.min() >= low - 1e-4 * abs(high), name
        assert values.max() <= high + 1e-4 * abs(high), name
        assert values.min() < low + 0.01 * (high - low), name
        assert values.max() > high - 0.01 * (high - low), name
        assert values.mean().item() == pytest.approx((low + high) / 2, abs=0.03 * (high - low)), name


def test_the_training_range_is_scaled_to_minus_one_and_one(intrinsics):
    x = sample(intrinsics, 4000, "train")
    assert x.abs().max() <= 1.0
    assert x.amin(0).max() < -0.99
    assert x.amax(0).min() > 0.99
    assert sample(intrinsics, 4000, "test").abs().max() > 1.5
    for parameter in intrinsics.parameters.values():
        assert [parameter.scaled(end) for end in parameter.train] == pytest.approx([-1.0, 1.0])
    for name, value in intrinsics.values(x).items():
        scaled = intrinsics.parameters[name].scaled(value).float()
        torch.testing.assert_close(scaled, x[:, intrinsics.slices[name]])


def test_off_is_nominal(intrinsics, scene):
    for name, values in physical(intrinsics, scene, sample(intrinsics, 3, "off")).items():
        np.testing.assert_allclose(values, RANGES[name][2], atol=1e-5, err_msg=name)


def test_unknown_randomization_lists_the_known_ones(intrinsics):
    with pytest.raises(ValueError, match="unknown randomization 'full'; choose one of train, test, off"):
        sample(intrinsics, 1, "full")


def check_truth(env: RidingEnv, x_int: torch.Tensor) -> None:
    """Every simulation's compiled model is what the emitted x_int says, and nothing else changed."""
    nominal, layout, robot, deck = env.scene.model, env.scene.layout, env.scene.robot, env.scene.support.spec
    support = env.scene.support_layout
    unit = UNIT * deck.spring_scale
    value = {name: each.numpy() for name, each in env.runner.intrinsics.values(x_int).items()}
    for i in range(env.batch_size[0]):
        model = compiled(env, i)
        trunk, decks = layout.trunk_body, support.board_bodies
        mass = nominal.body_mass[trunk] + value["payload"][i, 0]
        assert model.body_mass[trunk] == pytest.approx(mass, rel=1e-5)
        expected = nominal.body_inertia[trunk] * mass / nominal.body_mass[trunk]
        np.testing.assert_allclose(model.body_inertia[trunk], expected, rtol=1e-5)
        np.testing.assert_allclose(model.body_ipos[trunk], nominal.body_ipos[trunk] + value["com_shift"][i], atol=1e-6)
        deck_mass = deck.mass + value["platform_mass"][i, 0]
        np.testing.assert_allclose(model.body_mass[decks], deck_mass / len(decks), rtol=1e-5)
        expected = nominal.body_inertia[decks] * deck_mass / deck.mass
        np.testing.assert_allclose(model.body_inertia[decks], expected, rtol=1e-5)
        gains = model.actuator_gainprm[layout.actuators], model.actuator_biasprm[layout.actuators]
        np.testing.assert_allclose(gains[0][:, 0], robot.kp * value["kp"][i], rtol=1e-5)
        np.testing.assert_allclose(gains[1][:, 1], -robot.kp * value["kp"][i], rtol=1e-5)
        np.testing.assert_allclose(gains[1][:, 2], -robot.kd * value["kd"][i], rtol=1e-5)
        np.testing.assert_allclose(model.geom_friction[support.board_geoms, 0], value["friction"][i, 0], rtol=1e-5)
        table_ii = ("roll", "pitch") if len(decks) == 1 else ("pitch_right", "pitch_left")
        for column, name in enumerate(table_ii):
            joint = model.joint(f"platform_{name}")
            assert joint.stiffness[0] == pytest.approx(1.15 * unit * value["sb_stiffness"][i, column], rel=1e-5)
            assert joint.damping[0] == pytest.approx(0.025 * unit * value["sb_damping"][i, column], rel=1e-5)
        # derived constants followed
        total = nominal.body_subtreemass[trunk] + value["payload"][i, 0]
        assert model.body_subtreemass[trunk] == pytest.approx(total, rel=1e-5)
        others = [body for body in range(nominal.nbody) if body not in (trunk, *decks)]
        np.testing.assert_array_equal(model.body_mass[others], nominal.body_mass[others])


def compiled(env: RidingEnv, i: int):
    return env.engine.batch.get_model(i) if hasattr(env.engine, "batch") else env.engine.physics.model.ptr


@pytest.mark.parametrize("randomization", ["train", "test"])
@pytest.mark.parametrize(("robot", "transporter"), [("a1", "single_board"), ("anymal_c", "two_board")])
@pytest.mark.parametrize(("physics", "num_envs"), [("batch", 4), ("dm_control", 1)])
def test_x_int_tells_the_truth_and_resets_do_not_compound(physics, num_envs, robot, transporter, randomization):
    env = RidingEnv(
        robot,
        transporter,
        num_envs=num_envs,
        seed=0,
        physics=physics,
        randomization=randomization,
        num_threads=1,
    )
    for _ in range(4):
        x_int = env.reset()["privileged", "intrinsic"]
    check_truth(env, x_int)
    if num_envs > 1:
        mask = torch.tensor([[False], [True], [False], [True]])
        td = TensorDict({"privileged": {"intrinsic": x_int.clone()}, "_reset": mask}, [num_envs])
        after = env.reset(td)["privileged", "intrinsic"]
        assert (after != x_int).any(-1).tolist() == [False, True, False, True]
        check_truth(env, after)


def test_a_platform_never_loses_nine_tenths_of_its_mass(intrinsics, scene):
    x = sample(intrinsics, 1, "off")
    x[:, intrinsics.slices["platform_mass"]] = -100.0
    assert physical(intrinsics, scene, x)["platform_mass"].item() == pytest.approx(1.15)


def test_a_heavier_platform_accelerates_less():
    env = RidingEnv(num_envs=2, seed=0, randomization="off", pushes=False, num_threads=1)
    state = env.get_state()
    state["x_int"][0, env.runner.intrinsics.slices["platform_mass"]] = 1.0
    env.set_state(state)
    env.engine.qpos[:, env.scene.support_layout.tilt_qpos[0]] = 0.78
    env.engine.hook.apply(TIMESTEP)
    heavy, nominal = env.engine.hook.speeds[:, 0]
    assert (heavy / nominal).item() == pytest.approx(11.5 / 12.0, rel=1e-6)

"""Deck and engines against closed forms, invariants and each other."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS, Scene, Transporter, build_scene
from torchrl_atr.envs.models.scene import TIMESTEP
from torchrl_atr.envs.physics.batch import BatchEngine
from torchrl_atr.envs.physics.engine import DECIMATION
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks import riding, walking
from torchrl_atr.envs.tasks.riding.drive_law import DriveHook

CONTROL_DT = 0.02
STILL = torch.zeros(1, 0)
"""The block has no joints to command."""


class Prescribed:
    """A law that ramps both speeds at given rates up to a limit, whatever the tilt."""

    def __init__(self, rates: tuple[float, float], limit: float = np.inf) -> None:
        self.rates, self.limit = torch.tensor(rates, dtype=torch.float64), limit

    def __call__(self, speeds, tilt, scale, dt):
        return (speeds + dt * self.rates).clamp(-self.limit, self.limit)


def a1_on_a_board() -> Scene:
    return build_scene(ROBOTS.get("a1"), Transporter(TRANSPORTERS.get("single_board_g1")))


def stand(scene: Scene, n: int = 1) -> torch.Tensor:
    return torch.tensor([scene.robot.q0] * n, dtype=torch.float64)


def relative(engine: BatchEngine) -> np.ndarray:
    """Where the block stands in the yawing frame of the deck, m."""
    layout, support, qpos = engine.scene.layout, engine.scene.support_layout, engine.qpos[0].numpy()
    offset = qpos[layout.root_qpos : layout.root_qpos + 2] - qpos[support.planar_qpos[:2]]
    cos, sin = np.cos(qpos[support.planar_qpos[2]]), np.sin(qpos[support.planar_qpos[2]])
    return np.array([[cos, sin], [-sin, cos]]) @ offset


def ride(engine: BatchEngine, steps: int) -> None:
    for _ in range(steps):
        engine.step(STILL)


def test_weight_ahead_pitches_the_deck_and_drives_it_forward(block_engine):
    engine = block_engine((0.06, 0.0))
    ride(engine, 50)
    pitch, roll = engine.qpos[0, engine.scene.support_layout.tilt_qpos].tolist()
    speed, yaw_rate = engine.hook.speeds[0].tolist()
    assert pitch > 0.05
    assert speed > 0.5
    assert engine.world_offset[0, 0] > 0.2
    assert abs(roll) < 1e-9
    assert abs(yaw_rate) < 1e-9


@pytest.mark.parametrize("x", [0.06, -0.06])
@pytest.mark.parametrize("y", [0.06, -0.06])
def test_weight_at_a_corner_tilts_towards_it_and_turns_by_eq_3(block_engine, x, y):
    engine = block_engine((x, y))
    ride(engine, 50)
    pitch, roll = engine.qpos[0, engine.scene.support_layout.tilt_qpos].tolist()
    speed, yaw_rate = engine.hook.speeds[0].tolist()
    assert np.sign(pitch) == np.sign(x)  # nose down for a weight ahead
    assert np.sign(roll) == -np.sign(y)  # left side down for a weight on the left
    assert np.sign(speed) == np.sign(x)
    assert np.sign(yaw_rate) == np.sign(x) * np.sign(y)
    assert min(abs(pitch), abs(roll), abs(yaw_rate)) > 0.05


@pytest.mark.parametrize("block_scene", ["two_board_g1"], indirect=True)
def test_weight_ahead_pitches_both_boards_alike(block_engine):
    engine = block_engine((0.06, 0.0))
    ride(engine, 50)
    right, left = engine.qpos[0, engine.scene.support_layout.tilt_qpos].tolist()
    assert right > 0.03
    assert right == pytest.approx(left, abs=1e-6)  # no-slip iterations take contacts in their order
    assert engine.hook.speeds[0, 0] > 0.3
    assert abs(engine.hook.speeds[0, 1]) < 1e-6


@pytest.mark.parametrize("block_scene", ["two_board_g1"], indirect=True)
@pytest.mark.parametrize("x", [0.06, -0.06])
@pytest.mark.parametrize("y", [0.2, -0.2])
def test_weight_on_one_board_pitches_it_alone_and_turns_by_eq_10(block_engine, x, y):
    engine = block_engine((x, y))
    ride(engine, 20)
    right, left = engine.qpos[0, engine.scene.support_layout.tilt_qpos].tolist()
    loaded, empty = (left, right) if y > 0 else (right, left)
    assert loaded * np.sign(x) > 0.05
    assert abs(empty) < 1e-9
    assert engine.hook.speeds[0].sign().tolist() == [np.sign(x), np.sign(y)]  # sgn(θ_avg) undoes the sign of θ_dif


def test_static_tilt_balances_weight_and_spring(block_engine):
    engine = block_engine((0.02, 0.0))
    engine.hook.law = Prescribed((0.0, 0.0))
    ride(engine, 150)
    pitch, lever = np.empty(100), np.empty(100)
    for step in range(100):
        ride(engine, 1)
        pitch[step] = engine.qpos[0, engine.scene.support_layout.tilt_qpos[0]]
        lever[step] = relative(engine)[0]  # horizontal
    spring = 1.15 * 180 / np.pi
    assert spring * pitch.mean() == pytest.approx(12.0 * 9.81 * lever.mean(), rel=5e-3)
    assert pitch.min() > 0.03


@pytest.mark.parametrize("block_scene", ["single_board_g1", "two_board_g1"], indirect=True)
@pytest.mark.parametrize("axis", [0, 1])
def test_empty_deck_rings_down_as_stiffness_damping_and_inertia_say(block_engine, axis):
    engine = block_engine()
    layout, support, deck = engine.scene.layout, engine.scene.support_layout, engine.scene.support.spec
    engine.qpos[0, layout.root_qpos + 2] = 500.0  # the block falls from afar and never arrives
    engine.qpos[0, support.tilt_qpos[axis]] = 0.1
    states = []
    for _ in range(75):
        engine.step(STILL)
        states.append([float(engine.qpos[0, support.tilt_qpos[axis]]), float(engine.qvel[0, support.tilt_dof[axis]])])
    # (θ, θ̇) one control step later is a matrix times (θ, θ̇); its eigenvalues are the damped oscillation
    transition = np.linalg.lstsq(np.array(states[:-1]), np.array(states[1:]), rcond=None)[0]
    root = np.log(np.linalg.eigvals(transition).astype(complex))[0] / CONTROL_DT
    unit = 180 / np.pi
    stiffness, damping, inertia = 1.15 * unit, 0.025 * unit, deck.inertia[1 - axis]  # pitch, roll
    if len(deck.design.boards) == 2:
        inertia = deck.inertia[1] / 2  # either board's pitch
    decay = damping / (2 * inertia)
    frequency = np.sqrt(stiffness / inertia - decay**2)
    assert abs(root.imag) == pytest.approx(frequency, rel=0.01)
    assert root.real / abs(root.imag) == pytest.approx(-decay / frequency, rel=0.03)


def test_block_on_a_level_deck_at_three_metres_per_second_squared_stays_where_it_is(block_engine):
    engine = block_engine(level=True)
    ride(engine, 10)
    engine.hook.law = Prescribed((3.0, 0.0))
    ride(engine, 49)
    before = relative(engine)
    ride(engine, 50)
    assert engine.hook.speeds[0, 0] == pytest.approx(3.0 * 99 * CONTROL_DT)
    assert abs(relative(engine) - before).max() < 1e-5


@pytest.mark.parametrize("place", [0, 22.5, 45])
@pytest.mark.parametrize(("share", "slides"), [(0.9, False), (1.05, True)])
def test_block_on_a_turning_deck_slides_when_friction_cannot_hold_it(block_engine, share, slides, place):
    # in every direction alike: on a pyramidal cone it slides from 1/sqrt(2) of its friction on, by direction
    radius, friction = 0.2, 0.3
    rate = np.sqrt(share * friction * 9.81 / radius)
    engine = block_engine(
        (radius * np.cos(np.deg2rad(place)), radius * np.sin(np.deg2rad(place))), friction=friction, level=True
    )
    engine.hook.law = Prescribed((0.0, 2.0), limit=rate)
    ride(engine, int(rate / 2.0 / CONTROL_DT) + 1)
    before = relative(engine)
    ride(engine, 50)
    moved = np.linalg.norm(relative(engine) - before)
    outwards = radius * rate**2 * TIMESTEP / 2  # m/s: each step goes straight on where the deck turns
    assert moved > 0.2 if slides else moved == pytest.approx(outwards, rel=0.1)


def test_random_actions_of_the_rider_hardly_move_the_prescribed_motion():
    env = RidingEnv(num_envs=8, seed=0, num_threads=1, pushes=False)
    engine, support = env.engine, env.scene.support_layout
    generator, td, worst = torch.Generator().manual_seed(0), env.reset(), 0.0
    riding = torch.ones(8, dtype=torch.bool)
    for _ in range(50):
        td["action"] = torch.randn(8, 12, generator=generator)
        td = env.step(td)["next"]
        riding &= ~td["done"][:, 0]
        speed, yaw = engine.hook.speeds[:, :1], engine.qpos[:, support.planar_qpos[2:]]
        target = speed * torch.cat([yaw.cos(), yaw.sin()], -1)
        error = (engine.qvel[:, support.planar_dof[:2]] - target).abs().amax(-1)
        worst = max(worst, float(error[riding].max()))
    assert riding.sum() >= 2
    assert 0.0 < worst < 1e-3


def test_results_do_not_depend_on_the_number_of_threads():
    def trajectory(threads: int) -> TensorDict:
        env = RidingEnv(num_envs=5, seed=3, num_threads=threads)
        generator = torch.Generator().manual_seed(0)
        td, kept = env.reset(), []
        for step in range(30):
            td["action"] = 0.8 * torch.randn(5, 12, generator=generator)
            if step == 10:
                env.engine.qpos[2, env.scene.layout.root_qpos] += 1.0  # off the deck: its episode ends
            td, following = env.step_and_maybe_reset(td)
            kept.append(td)
            td = following
        return torch.stack(kept)

    one, two = trajectory(1), trajectory(2)
    assert one["next", "done"][10, 2]
    assert one["next", "speeds"].abs().max() > 0.05
    assert (one == two).all()


def test_both_engines_give_the_same_trajectory_recentring_included():
    batch = RidingEnv(num_envs=1, seed=0, num_threads=1, pushes=False)
    reference = RidingEnv(num_envs=1, seed=9, physics="dm_control", pushes=False)
    batch.engine.hook.speeds[:] = torch.tensor([[2.0, 0.4]])
    reference.set_state(batch.get_state())
    generator = torch.Generator().manual_seed(1)
    for _ in range(200):
        targets = stand(batch.scene) + 0.05 * torch.randn(1, 12, generator=generator)
        batch.engine.step(targets)
        reference.engine.step(targets)
        theirs = reference.engine.get_state()
        for name, value in batch.engine.get_state().items():
            np.testing.assert_allclose(value, theirs[name], atol=1e-9, rtol=0, err_msg=name)
    np.testing.assert_allclose(batch.engine.sensordata, reference.engine.sensordata, atol=1e-6)
    np.testing.assert_allclose(batch.engine.actuator_force, reference.engine.actuator_force, atol=1e-6)
    assert batch.engine.world_offset.norm() > 2.0
    assert batch.engine.qpos[0, batch.scene.support_layout.planar_qpos[:2]].abs().max() < 0.5


@pytest.mark.parametrize("make_task", [riding, walking])
def test_both_engines_emit_the_same_steps(make_task):
    task, generator = make_task(pushes=False), torch.Generator().manual_seed(0)
    batch = QuadrupedEnv(task, 1, seed=0, num_threads=1)
    reference = QuadrupedEnv(task, 1, "dm_control", seed=9)
    state = batch.get_state().exclude("foot_places")  # they are near the origin
    state["world_offset"] += 100.0  # far out, where the origin of the numbers shows if anything does
    for env in (reference, batch):
        env.set_state(state.clone())
    steps = []
    for _ in range(25):
        action = 0.2 + 0.2 * torch.randn(1, 12, generator=generator)
        step = TensorDict({"action": action, "command": torch.tensor([[0.5, 0.3]])}, [1])
        ours, theirs = (env.step(step.clone())["next"] for env in (batch, reference))
        for key in ours.keys(True, True):
            torch.testing.assert_close(ours[key], theirs[key], atol=2e-5, rtol=1e-4, msg=str(key))
        steps.append(ours)
    moved = torch.stack(steps)
    assert (moved["observation"].std(0) > 0).sum() > 40
    assert not moved["terminated"].any()
    np.testing.assert_allclose(batch.engine.world_offset, reference.engine.world_offset, atol=1e-9)


def test_both_engines_walk_alike_recentring_included():
    task = walking(pushes=False)
    batch = QuadrupedEnv(task, 1, seed=0, num_threads=1)
    reference = QuadrupedEnv(task, 1, "dm_control", seed=9)
    batch.engine.qvel[:, batch.scene.layout.root_dof] = 2.0
    reference.set_state(batch.get_state())
    generator = torch.Generator().manual_seed(1)
    for _ in range(60):
        targets = stand(batch.scene) + 0.05 * torch.randn(1, 12, generator=generator)
        for env in (batch, reference):
            env.engine.step(targets)
        theirs = reference.engine.get_state()
        for name, value in batch.engine.get_state().items():
            np.testing.assert_allclose(value, theirs[name], atol=1e-9, rtol=0, err_msg=name)
    assert batch.engine.world_offset[0, 0] > 0.2
    assert batch.engine.qpos[0, batch.scene.layout.origin_qpos].abs().max() < 0.05


def test_recentring_changes_nothing_but_the_origin():
    env = RidingEnv(num_envs=2, seed=0, num_threads=1, pushes=False)
    td = env.reset()
    layout, support, engine = env.scene.layout, env.scene.support_layout, env.engine
    for columns in (support.planar_qpos[:2], [layout.root_qpos, layout.root_qpos + 1]):
        engine.qpos[1, columns] = engine.qpos[0, columns] + torch.tensor([3.0, -7.0])
    rest = np.setdiff1d(
        np.arange(engine.qpos.shape[1]), [*support.planar_qpos[:2], layout.root_qpos, layout.root_qpos + 1]
    )
    engine.qpos[1, rest] = engine.qpos[0, rest]
    for name, field in engine.fields.items():
        field[1] = field[0]
        assert (field[1] == field[0]).all(), name
    engine.batch.set_const(np.arange(2))
    engine.hook.refresh(torch.arange(2))
    for _ in range(30):
        td["action"] = torch.full((2, 12), 0.05)
        td = env.step(td)["next"]
    np.testing.assert_allclose(engine.world_offset[1] - engine.world_offset[0], [3.0, -7.0], atol=1e-9)
    np.testing.assert_allclose(engine.qpos[1], engine.qpos[0], atol=1e-9)


def test_dm_control_engine_keeps_the_scene_as_it_is():
    from torchrl_atr.envs.physics.dmc import DmControlEngine

    scene = a1_on_a_board()
    nominal = {name: getattr(scene.model, name).copy() for name in ("body_mass", "jnt_stiffness", "geom_friction")}
    first, second = DmControlEngine(scene, DriveHook), DmControlEngine(scene, DriveHook)
    first.fields["body_mass"][0, scene.layout.trunk_body] += 1.0
    assert first.physics.model.body_mass[scene.layout.trunk_body] == pytest.approx(5.0)
    assert second.physics.model.body_mass[scene.layout.trunk_body] == pytest.approx(4.0)
    for name, value in nominal.items():
        np.testing.assert_array_equal(getattr(scene.model, name), value)


def test_dm_control_physics_obeys_the_law_by_itself():
    from torchrl_atr.envs.physics.dmc import DmControlEngine

    scene = a1_on_a_board()
    ours, theirs = (DmControlEngine(scene, DriveHook) for _ in range(2))
    for engine in (ours, theirs):
        engine.hook.speeds[:] = torch.tensor([[1.0, 0.3]])
        engine.command(stand(scene))
    ours.advance(DECIMATION)
    theirs.physics.step(DECIMATION)
    np.testing.assert_array_equal(ours.qpos, theirs.physics.data.qpos[None])
    assert theirs.qvel[0, scene.support_layout.planar_dof[0]] == pytest.approx(1.0, abs=0.01)


def test_physics_without_an_engine_refuses_to_step():
    from torchrl_atr.envs.physics.dmc import DmControlEngine, EnginePhysics

    scene = a1_on_a_board()
    copied = DmControlEngine(scene, DriveHook).physics.copy()
    assert isinstance(copied, EnginePhysics)
    with pytest.raises(RuntimeError, match="has no engine to step with"):
        copied.step()


@pytest.mark.parametrize("name", ["batch", "dm_control"])
def test_set_state_names_what_is_wrong(name):
    env = RidingEnv(num_envs=1, physics=name, seed=0)
    state = env.engine.get_state()
    with pytest.raises(KeyError, match="warmstart"):
        env.engine.set_state({key: value for key, value in state.items() if key != "warmstart"})
    with pytest.raises(ValueError, match="qvel"):
        env.engine.set_state({**state, "qvel": state["qvel"][:, 1:]})


def test_sensors_are_those_of_the_last_substep_and_of_no_other():
    """Only what is read is computed; an interrupt between substeps must not leave them off."""
    scene = a1_on_a_board()
    one, other = BatchEngine(scene, 2, DriveHook, 1), BatchEngine(scene, 2, DriveHook, 1)
    generator = torch.Generator().manual_seed(0)
    for _ in range(10):
        targets = stand(scene, 2) + 0.2 * torch.randn(2, 12, generator=generator)
        one.step(targets)
        other.command(targets)
        for _ in range(DECIMATION):
            other.advance(1)  # each is the last
        np.testing.assert_array_equal(one.sensordata, other.sensordata)
        np.testing.assert_array_equal(one.qpos, other.qpos)
    one.hook.apply(TIMESTEP)
    one._substep(last=False)
    one.forward()
    other.advance(1)
    other.forward()
    np.testing.assert_array_equal(one.sensordata, other.sensordata)


@pytest.mark.parametrize(("physics", "num_envs"), [("batch", 3), ("dm_control", 1)])
def test_a_torque_and_its_velocity_are_of_one_instant(physics, num_envs):
    envs = [RidingEnv(num_envs=num_envs, seed=4, physics=physics, num_threads=1) for _ in range(2)]
    before, engine = (env.engine for env in envs)
    for each in (before, engine):
        each.command(stand(each.scene, num_envs) + 0.3 * torch.arange(12).cos())
    before.advance(DECIMATION - 1)
    engine.advance(DECIMATION)
    layout = engine.scene.layout
    angle, velocity = before.qpos[:, layout.joint_qpos], before.qvel[:, layout.joint_dof]
    np.testing.assert_array_equal(engine.torque_velocity, velocity)
    kp = engine.fields["actuator_gainprm"][:, layout.actuators, 0]
    kd = -engine.fields["actuator_biasprm"][:, layout.actuators, 2]
    limit = torch.tensor(engine.scene.robot.torque_limits, dtype=torch.float64).repeat(4)
    torque = (kp * (engine.ctrl[:, layout.actuators] - angle) - kd * velocity).clamp(-limit, limit)
    np.testing.assert_allclose(engine.actuator_force[:, layout.actuators], torque, atol=1e-9)

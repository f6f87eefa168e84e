"""Other numerics than in training, and actions that take effect late."""

from __future__ import annotations

import pickle

import pytest
import torch

from torchrl_atr.envs import RidingEnv, Simulation
from torchrl_atr.envs.physics import CONTROL_DT, DECIMATION


def make(physics, num_envs=2):
    return RidingEnv(num_envs=num_envs, seed=0, num_threads=1, randomization="off", physics=physics)


def test_the_numerics_are_the_models_and_the_control_period_stays():
    env = make(Simulation(timestep=0.0025, solver="cg", iterations=30, cone="pyramidal", integrator="euler"))
    option = env.model.opt
    assert (option.timestep, option.iterations, option.solver, option.cone, option.integrator) == (0.0025, 30, 1, 0, 0)
    assert env.engine.decimation == 2 * DECIMATION
    env.rollout(3)
    assert env.engine.time.tolist() == pytest.approx([3 * CONTROL_DT] * 2)
    assert not env.engine.diverged.any()


def test_half_the_time_step_rides_nearly_alike():
    """The law and the contacts are discretised, not changed."""
    speeds = []
    for physics in ("batch", Simulation(timestep=0.0025)):
        env = make(physics)
        action = env.full_action_spec.zero()
        action["action"][:, [0, 3]] = 0.3  # right legs bend: the board tilts
        td = env.reset()
        for _ in range(20):
            td = env.step(td.update(action))["next"]
        speeds.append(env.engine.hook.speeds.clone())
    assert speeds[0].abs().max() > 1e-3
    torch.testing.assert_close(*speeds, rtol=0.2, atol=5e-3)


@pytest.mark.parametrize("at_once", [1, 2, 4])
def test_a_delay_counts_substeps_since_the_command_however_they_are_made(at_once):
    env = make(Simulation(action_delay=0.01))
    engine, stand = env.engine, torch.tensor(env.scene.robot.q0)
    engine.command((stand + 0.1).expand(len(engine.qpos), -1))
    for _ in range(4 // at_once):
        engine.advance(at_once)
    torch.testing.assert_close(engine.ctrl[0, engine._actuators].float(), stand + 0.1)


@pytest.mark.parametrize(("delay", "late"), [(0.005, 1), (0.02, 4), (0.035, 7)])
def test_targets_take_effect_after_their_delay(delay, late):
    engine, stand = (env := make(Simulation(action_delay=delay))).engine, torch.tensor(make("batch").scene.robot.q0)
    joints = env.scene.layout.actuators
    seen = []
    apply = engine.hook.apply
    substep = engine._substep
    engine._substep = lambda last: (seen.append(engine.ctrl[0, joints[0]].item()), substep(last))
    engine.hook.apply = apply
    for step in range(4):
        engine.step(stand.double().repeat(2, 1) + 0.01 * (step + 1))
    given = [0.0] * late + [0.01 * (step + 1) for step in range(4) for _ in range(DECIMATION)]
    assert seen == pytest.approx([float(stand[0]) + offset for offset in given[: 4 * DECIMATION]])


def test_targets_under_way_are_part_of_the_state_and_of_copies_and_end_with_the_episode():
    env = make(Simulation(action_delay=0.03))
    actions = torch.randn(6, 2, 12, generator=torch.Generator().manual_seed(0)) * 0.2
    td = env.reset()

    def ride(env, td, rows):
        for action in actions[rows]:
            td = env.step(td.set("action", action))["next"]
        return td["proprio"]

    ride(env, td, slice(3))
    saved, copied = env.get_state(), pickle.loads(pickle.dumps(env))
    after = ride(env, td, slice(3, 6))
    assert torch.equal(ride(copied, td.clone(), slice(3, 6)), after)
    env.set_state(saved)
    assert torch.equal(ride(env, td, slice(3, 6)), after)
    env.reset()
    assert torch.equal(
        env.engine.get_state()["targets"], make(Simulation(action_delay=0.03)).engine.get_state()["targets"]
    )


def test_the_scene_that_is_given_stays_as_it_is():
    scene = make("batch").scene
    assert Simulation(timestep=0.01).applied(scene).model.opt.timestep == 0.01
    assert scene.model.opt.timestep == 0.005
    assert Simulation().applied(scene) is scene


@pytest.mark.parametrize(
    ("field", "text"),
    [
        ({"timestep": 0.003}, r"timestep=0.003 must divide the control period, 0.02 s; take 0.00285714"),
        ({"solver": "fast"}, "solver"),
        ({"action_delay": 2.0}, "action_delay=2.0"),
        ({"engine": "bullet"}, "unknown physics 'bullet'"),
    ],
)
def test_what_does_not_fit_is_named(field, text):
    with pytest.raises(ValueError, match=text):
        make(Simulation(**field))

from functools import partial

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.envs import TransformedEnv

from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.transforms import task_transforms
from torchrl_atr.evaluation import command_grid, evaluate_tracking
from torchrl_atr.evaluation import ride as ride_module
from torchrl_atr.evaluation.tracking import summarise
from torchrl_atr.modules import make_networks

from .conftest import PuppetEnv, policy_of, puppet_env


def test_the_default_grid_is_the_evaluations():
    speeds, yaw_rates = command_grid()
    assert speeds.tolist() == [-2, -1, 0, 1, 2]
    assert yaw_rates.tolist() == [-1, -0.75, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 1]
    assert 0.0 in command_grid(15, 2, 0.1, 0.1)[0]
    assert len(command_grid(15, 2, 0.1, 0.1)[0]) == 301


@pytest.mark.parametrize("step", [0.0, -1.0, 0.3])
def test_a_step_that_does_not_divide_the_grid_is_an_error(step):
    with pytest.raises(ValueError, match=f"speed.* step {step:g}"):
        command_grid(v_step=step)


def test_a_perfect_tracker_has_no_error(evaluate):
    result = evaluate(lambda command: command)
    assert result.fall_time.shape == (3, 3, 2)
    assert result.survived.all()
    for error in ("rms_speed_error", "rms_yaw_error", "settled_speed_error", "settled_yaw_error"):
        assert (getattr(result, error) == 0).all()
    assert (result.settled_speed == result.speed_commands[:, None, None]).all()
    assert (result.settled_yaw_rate == result.yaw_commands[None, :, None]).all()


def test_errors_by_hand(evaluate):
    """Speed 1 above the command for 10 steps, then exact; yaw rate always 0.25 below."""
    count = iter(range(20))

    def late(command):
        return command + torch.tensor([1.0 if next(count) < 10 else 0.0, -0.25])

    result = evaluate(late)
    np.testing.assert_allclose(result.rms_speed_error, np.sqrt(0.5), rtol=1e-6)
    np.testing.assert_allclose(result.settled_speed_error, 0, atol=1e-7)
    np.testing.assert_allclose(result.rms_yaw_error, 0.25, rtol=1e-6)
    np.testing.assert_allclose(result.settled_yaw_error, 0.25, rtol=1e-6)


def test_errors_of_either_sign_do_not_cancel():
    measured = np.array([[[1.0, -0.5]], [[-1.0, 0.5]]] * 2)
    figures = summarise(measured, np.ones((5, 1), dtype=bool), [[0.0, 0.0]], 0.02, 0)
    assert figures["settled_speed_error"] == figures["rms_speed_error"] == [1.0]
    assert figures["settled_yaw_error"] == [0.5]
    assert figures["settled_speed"] == figures["settled_yaw_rate"] == [0.0]


def test_a_fall_ends_a_trials_figures(evaluate):
    """Rows whose c_v is 2 are one off and fall in step 5; the others are perfect to the end."""
    count = iter(range(20))

    def falling(command):
        action, fast = command.clone(), command[:, 0] == 2
        step = next(count)
        action[fast, 0] += 1.0 if step < 5 else 100.0
        if step == 4:
            action[fast] = torch.nan
        return action

    result = evaluate(falling)
    assert result.survived[:2].all()
    assert not result.survived[2].any()
    np.testing.assert_allclose(result.fall_time[2], 0.5)
    np.testing.assert_allclose(result.rms_speed_error[2], 1.0, rtol=1e-6)
    assert np.isnan(result.settled_speed_error[2]).all()
    assert (result.rms_speed_error[:2] == 0).all()


def test_a_fallen_robot_is_neither_reset_nor_driven(evaluate):
    """Of a policy that says NaN for ever only zeros get through after the fall."""
    made = []

    def make_env(num_envs, seed):
        made.append(puppet_env(num_envs, seed))
        return made[-1]

    result = evaluate(lambda command: torch.full_like(command, torch.nan), make_env=make_env)
    np.testing.assert_allclose(result.fall_time, 0.1)
    assert made[0].base_env.steps_taken == 20
    assert (made[0].base_env.speeds == 0).all()


def test_chunks_change_nothing_and_have_their_own_seeds(evaluate, monkeypatch):
    seeds = []

    def make_env(num_envs, seed):
        seeds.append((num_envs, seed))
        return puppet_env(num_envs, seed)

    whole = evaluate(lambda command: 0.5 * command, make_env=make_env)
    monkeypatch.setattr(ride_module, "MAX_ROBOTS", 7)
    parts = evaluate(lambda command: 0.5 * command, make_env=make_env, seed=5)
    assert seeds == [(18, 0), (7, 5), (7, 6), (4, 7)]
    np.testing.assert_array_equal(whole.rms_speed_error, parts.rms_speed_error)
    np.testing.assert_array_equal(whole.settled_yaw_rate, parts.settled_yaw_rate)


def test_the_policy_sees_its_in_keys_only_and_is_left_as_it_was(evaluate):
    seen = []

    class Policy(TensorDictModule):
        def forward(self, tensordict, *args, **kwargs):
            seen.append((set(tensordict.keys(True, True)), self.training))
            return super().forward(tensordict, *args, **kwargs)

    policy = Policy(lambda command: command, in_keys=["command"], out_keys=["action"])
    result = evaluate(policy)
    assert all(keys <= {"command", "action"} and not training for keys, training in seen)
    assert result.policy_reads == ("command",)
    assert policy.training


def test_estimator_errors_by_hand(evaluate):
    """x̂ misses the four states by 0, 0.5, 1 and 1.5; ẑ is zero where the encoder says (1, 1, 1)."""
    off = torch.tensor([0.0, 0.5, -1.0, 1.5])

    def decide(command):
        n = len(command)
        return command, (torch.arange(4.0) + off).expand(n, 4), torch.zeros(n, 3)

    outs = ["action", ("estimate", "extrinsic"), ("estimate", "intrinsic")]
    policy = TensorDictModule(decide, in_keys=["command"], out_keys=outs)
    encoder = TensorDictModule(lambda x: x, in_keys=[("privileged", "intrinsic")], out_keys=[("latent", "intrinsic")])
    errors = evaluate(policy, encoder_module=encoder).estimators
    assert errors.extrinsic.shape == (3, 3, 2, 4)
    assert (errors.steps == 20).all()
    latent, extrinsic = errors.moments()
    assert latent == pytest.approx((3**0.5, 0.0), abs=1e-6)
    assert [component.name for component, *_ in extrinsic] == [f"extrinsic[{i}]" for i in range(4)]
    np.testing.assert_allclose([mean for _, mean, _ in extrinsic], off.abs(), atol=1e-6)
    assert evaluate(policy).estimators.latent is None
    assert evaluate(lambda command: command).estimators is None


def test_estimator_errors_stop_at_the_fall(evaluate):
    """Off by 1 while up, by 100 after the fall in the first step: only the first counts."""
    count = iter(range(20))

    def decide(command):
        first = next(count) == 0
        action = torch.full_like(command, torch.nan)
        return action, torch.arange(4.0).expand(len(command), 4) + (1.0 if first else 100.0)

    policy = TensorDictModule(decide, in_keys=["command"], out_keys=["action", ("estimate", "extrinsic")])
    errors = evaluate(policy).estimators
    assert (errors.steps == 1).all()
    np.testing.assert_allclose(errors.extrinsic, 1.0, atol=1e-6)


def test_progress_counts_all_chunks(evaluate, monkeypatch):
    monkeypatch.setattr(ride_module, "MAX_ROBOTS", 9)
    calls = []
    evaluate(lambda command: command, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(step, 40) for step in range(1, 41)]


def test_bad_input_is_named(evaluate):
    with pytest.raises(TypeError, match="pin commands"):
        evaluate(lambda command: command, make_env=lambda num_envs, seed: PuppetEnv(num_envs))
    with pytest.raises(TypeError, match="pass speeds="):
        evaluate_tracking(policy_of(lambda command: command), puppet_env, ([0.0], [0.0]), 1, 0.1, 0.0)
    with pytest.raises(ValueError, match="built an env of batch size"):
        evaluate(lambda command: command, make_env=lambda num_envs, seed: puppet_env(3, seed))
    with pytest.raises(ValueError, match="settle"):
        evaluate_tracking(policy_of(lambda command: command), puppet_env, seconds=1.0, settle=1.0)
    with pytest.raises(ValueError, match="at least one robot"):
        evaluate(lambda command: command, robots=0)


def _riding(num_envs, seed):
    env = RidingEnv(num_envs=num_envs, seed=seed, pushes=False, num_threads=1)
    return TransformedEnv(env, task_transforms((0.16, 0.16), history_length=3, seed=seed))


def test_the_deployed_policy_on_the_real_env():
    """Two commands, two robots each, a second: all is finite, and the same seed gives the same figures."""
    env = _riding(1, 0)
    networks = make_networks(
        env.observation_spec, env.action_spec, estimator="mlp", estimator_inputs=["dead_reckoned_velocity"]
    )
    run = partial(
        evaluate_tracking,
        networks.deployed_policy(),
        _riding,
        ([0.0, 0.5], [0.0]),
        2,
        1.0,
        0.5,
        encoder_module=networks.encoder_module,
    )
    result, again = run(), run()
    assert result.rms_speed_error.shape == (2, 1, 2)
    assert np.isfinite(result.rms_speed_error).all()
    np.testing.assert_array_equal(result.rms_speed_error, again.rms_speed_error)
    assert set(result.policy_reads) == {"history", "observation", "dead_reckoned_velocity"}
    assert result.rms_speed_error[0, 0, 0] != result.rms_speed_error[0, 0, 1]  # intrinsics of their own
    extrinsic = env.observation_spec["privileged", "extrinsic"].shape[-1]
    assert len(result.estimators.components) == extrinsic
    assert result.estimators.components[0] == ("contacts[0]", "contact FR", "1")
    assert np.isfinite(result.estimators.latent).all()


def test_a_riding_policy_that_holds_the_stand_is_measured_on_the_platform():
    """Zero actions and zero commands: the measured speed error is the engine's own speed."""
    zeros = TensorDictModule(
        lambda observation: observation.new_zeros(len(observation), 12),
        in_keys=["observation"],
        out_keys=["action"],
    )
    made = []

    def make_env(num_envs, seed):
        made.append(_riding(num_envs, seed))
        return made[-1]

    result = evaluate_tracking(TensorDictSequential(zeros), make_env, ([0.0], [0.0]), 2, 0.02, 0.0)
    speeds = made[0].base_env.engine.hook.speeds
    np.testing.assert_allclose(result.rms_speed_error[0, 0], np.abs(speeds[:, 0]), rtol=1e-6)
    np.testing.assert_allclose(result.settled_yaw_rate[0, 0], speeds[:, 1], rtol=1e-6)

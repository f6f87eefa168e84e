"""The learner on a GPU, physics on the CPU; runs where there is one."""

from __future__ import annotations

import warnings

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchrl_atr.envs import make_env, make_riding_env
from torchrl_atr.modules import DeviceBridge
from torchrl_atr.training import Trainer, checkpoint_config, load_checkpoint, load_run, make_config, make_run_networks

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device; torch finds none here")
SETTINGS = {
    "env.num_envs": 8,
    "ppo.rollout_steps": 8,
    "total_frames": 3 * 64,
    "compute.num_threads": 1,
    "compute.device": "cuda",
}


@pytest.mark.parametrize("compiled", [False, True])
def test_it_trains_there_and_goes_on_and_rides_without_it(tmp_path, compiled):
    metrics = []
    trainer = Trainer(make_config({**SETTINGS, "compute.compiled": compiled}), tmp_path / "run")
    trainer.train(metrics.append)
    assert {parameter.device.type for parameter in trainer.learner.networks.parameters()} == {"cuda"}
    assert trainer.env.base_env.device.type == "cpu"
    assert all(torch.isfinite(torch.tensor(list(m.values()))).all() for m in metrics)
    _, env, networks, _ = load_run(tmp_path / "run", num_envs=2)
    assert env.rollout(3, networks.deployed_policy())["action"].device.type == "cpu"
    begun = Trainer(
        make_config({**SETTINGS, "compute.compiled": compiled}), tmp_path / "begun", begin_from=tmp_path / "run"
    )
    assert begun.train() is None
    state = load_checkpoint(tmp_path / "run")
    resumed = Trainer(
        checkpoint_config(
            state, tmp_path, (), {"compute.device": "cpu", "compute.compiled": False, "total_frames": 4 * 64}
        ),
        tmp_path / "run",
        state,
    )
    assert resumed.train() is None
    assert resumed.frames == 4 * 64


def learned(tmp_path, **settings):
    """A learner's parameters and metrics after several updates on one batch that both of them see."""
    torch.manual_seed(0)
    trainer = Trainer(make_config({**SETTINGS, "ppo.minibatches": 1, **settings}), tmp_path)
    batch = trainer.collection.collect().clone()
    metrics = [trainer.learner.update(batch.clone()) for _ in range(3)]
    trainer._close()
    return {name: p.detach().clone() for name, p in trainer.learner.networks.named_parameters()}, metrics


@pytest.fixture
def uncompiled_env(monkeypatch):
    """What ``compiled`` does on a GPU alone: the env's functions stay eager."""
    monkeypatch.setattr("torchrl_atr.envs.make_env", _eager_env)


def _eager_env(task, **arguments):
    return make_env(task, **{**arguments, "compiled": False})


def test_captured_steps_do_what_the_eager_ones_do(tmp_path, uncompiled_env):
    wanted, plain = learned(tmp_path / "eager")
    tensors, metrics = learned(tmp_path / "captured", **{"compute.compiled": True})
    for ours, theirs in zip(metrics, plain, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-3, abs=1e-5)
    for name, tensor in tensors.items():
        torch.testing.assert_close(tensor, wanted[name], atol=1e-5, rtol=1e-3)


def waits(act):
    """How often something waits for the GPU."""
    torch.cuda.set_sync_debug_mode("warn")
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            act()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    return [str(warning.message) for warning in caught if "synchroniz" in str(warning.message)]


@pytest.mark.parametrize("compiled", [False, True])
def test_no_optimiser_step_waits_for_the_gpu(tmp_path, uncompiled_env, compiled):
    found = []
    for epochs in (2, 7):
        settings = {**SETTINGS, "compute.compiled": compiled, "ppo.epochs": epochs, "estimator.epochs": epochs}
        trainer = Trainer(make_config(settings), tmp_path / str(epochs))
        for _ in range(3):
            trainer.iterate()
        batch = trainer.collection.collect().clone()
        found.append(len(waits(lambda learner=trainer.learner, data=batch: learner.update(data))))
        trainer._close()
    assert found[0] == found[1]


@pytest.mark.parametrize("captured", [False, True])
def test_a_policy_there_writes_what_it_writes_here_and_waits_for_that_alone(captured):
    env = make_riding_env(num_envs=4, num_threads=1)
    torch.manual_seed(0)
    networks = make_run_networks(make_config({"env.num_envs": 4, "compute.num_threads": 1}), env)
    data, plain = env.reset(), networks.rollout_policy("mixed", 0.5)
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        wanted = plain(data.clone()).select(*plain.out_keys)
        policy = DeviceBridge(networks.to("cuda").rollout_policy("mixed", 0.5), "cuda", captured)
        for _ in range(6):
            written = policy(data.clone()).select(*plain.out_keys)
            assert {value.device.type for value in written.values(True, True)} == {"cpu"}
            for key in plain.out_keys:
                torch.testing.assert_close(written[key], wanted[key], atol=1e-3, rtol=1e-3)
        sent = policy._sent(data.select(*policy.in_keys))
        assert waits(lambda: policy._run(sent)) == []
    assert isinstance(sent, TensorDict)

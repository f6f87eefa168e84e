"""The recipe end to end on a tiny run: it learns something, writes a readable folder, and goes on from it."""

from __future__ import annotations

import csv
import tomllib

import pytest
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchrl_atr.modules import DeviceBridge, available_estimators, register_estimator
from torchrl_atr.modules.estimators import get_estimator
from torchrl_atr.training import Trainer, collection, load_checkpoint, load_run, make_config

TINY = {
    "env.num_envs": 8,
    "ppo.rollout_steps": 8,
    "total_frames": 3 * 64,
    "compute.num_threads": 1,
    "ppo.minibatches": 2,
    "ppo.epochs": 2,
}
TINY["compute.torch_threads"] = 1  # what is compared bit for bit must not depend on who else works here


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    metrics = []
    Trainer(make_config(TINY), folder).train(metrics.append)
    return folder, metrics


def test_the_folder_is_readable(run):
    folder, metrics = run
    assert {"config.toml", "checkpoint.pt", "progress.csv", "tensorboard"} <= {f.name for f in folder.iterdir()}
    assert tomllib.loads((folder / "config.toml").read_text())["env"]["num_envs"] == 8
    with (folder / "progress.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(float(row["frames"])) for row in rows] == [64, 128, 192]
    assert {"speed_error", "yaw_error", "command_area", "latent_error", "extrinsic_error"} <= set(rows[0])
    assert all(torch.isfinite(torch.tensor(list(m.values()))).all() for m in metrics)


def test_the_checkpoint_restores_the_deployed_policy_bit_for_bit(tmp_path):
    trainer = Trainer(make_config({**TINY, "total_frames": 64}), tmp_path / "run")
    trainer.train()
    _, env, restored, _ = load_run(tmp_path / "run", num_envs=4, seed=3)
    actions = []
    for networks in (trainer.learner.deployed, restored):
        env.base_env.set_seed(3)
        env.curriculum.set_seed(3)
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            actions.append(env.rollout(3, networks.deployed_policy())["action"])
    assert torch.equal(*actions)


def test_resume_goes_on_where_the_run_stopped(run):
    folder, _ = run
    state = load_checkpoint(folder)
    state["curriculum"]["weights"][3, 4] = 0.625  # so that forgetting to restore it would show
    config = make_config(state["config"], {"total_frames": 5 * 64})
    trainer = Trainer(config, folder, state)
    moments = state["learner"]["optimizers"]["policy"]["state"][0]["exp_avg"]
    assert torch.equal(trainer.learner.optimizers["policy"].state_dict()["state"][0]["exp_avg"], moments)
    assert torch.equal(trainer.curriculum.weights, state["curriculum"]["weights"])
    assert trainer.learner.schedule.get_last_lr() == [state["learner"]["optimizers"]["policy"]["param_groups"][0]["lr"]]
    trainer.train()
    with (folder / "progress.csv").open() as file:
        assert [int(float(row["frames"])) for row in csv.DictReader(file)] == [64, 128, 192, 256, 320]
    assert load_checkpoint(folder)["frames"] == 320


def test_a_run_goes_on_here_wherever_its_policy_was(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(collection, "_for_cpu_data", lambda policy, *_: DeviceBridge(policy, "cpu").forward)
        Trainer(make_config({**TINY, "total_frames": 2 * 64}), tmp_path / "there").train()
    Trainer(make_config({**TINY, "total_frames": 2 * 64}), tmp_path / "here").train()
    ends = []
    for name in ("there", "here"):
        state = load_checkpoint(tmp_path / name)
        Trainer(make_config(state["config"], {"total_frames": 3 * 64}), tmp_path / name, state).train()
        ends.append(load_checkpoint(tmp_path / name)["learner"]["networks"])
    for name, value in ends[0].items():
        assert torch.equal(value, ends[1][name]), name


@pytest.mark.parametrize("source", ["privileged", "estimated", "mixed"])
def test_the_first_importance_ratio_is_one(tmp_path, source):
    config = make_config({**TINY, "roa.act_source": source, "total_frames": 64, "ppo.epochs": 1, "ppo.minibatches": 1})
    metrics = []
    Trainer(config, tmp_path / source).train(metrics.append)
    assert abs(metrics[0]["mean_ratio"] - 1) < 1e-4
    assert abs(metrics[0]["max_ratio"] - 1) < 1e-4


def test_a_critic_without_privileges_trains_and_is_restored(tmp_path):
    config = make_config({**TINY, "ppo.privileged_critic": False, "total_frames": 64})
    metrics = []
    Trainer(config, tmp_path / "run").train(metrics.append)
    assert metrics[0]["loss_critic"] > 0
    _, _, networks, _ = load_run(tmp_path / "run")
    assert networks.critic_module.in_keys == ["observation"]


def test_an_estimator_from_outside_trains(tmp_path):
    if "outsider" not in available_estimators():
        mlp = get_estimator("mlp")
        register_estimator("outsider", lambda history_shape, out_features: mlp(history_shape, out_features))
    trainer = Trainer(make_config({**TINY, "estimator.name": "outsider", "total_frames": 64}), tmp_path / "run")
    before = [p.clone() for p in trainer.learner.networks.estimator_parameters()]
    trainer.train()
    assert any(not torch.equal(a, b) for a, b in zip(before, trainer.learner.networks.estimator_parameters()))


def test_what_a_killed_run_left_half_written_is_swept(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    (run / ".checkpoint.4711.part.pt").write_bytes(b"half")
    (run / ".mine").write_text("kept")
    Trainer(make_config(TINY), run)
    assert [file.name for file in run.iterdir()] == [".mine"]


def test_a_new_run_in_an_old_ones_folder_is_not_mixed_with_it(tmp_path):
    run = tmp_path / "run"
    for seed in (1, 2):
        Trainer(make_config({**TINY, "seed": seed}), run).train()
    assert not (run / "best.pt").exists()
    assert load_checkpoint(run / "previous.pt")["config"]["seed"] == 2


def test_a_callback_can_end_a_run_and_the_trainer_goes_on(tmp_path):
    trainer = Trainer(make_config(TINY), tmp_path / "run")
    assert trainer.train(lambda metrics: metrics["iteration"] == 1) is None
    trainer.save()
    assert load_checkpoint(tmp_path / "run")["collection"]
    trainer.train()
    assert trainer.finished


def test_a_reader_who_left_does_not_end_the_run(tmp_path, monkeypatch):
    def closed(text):
        raise BrokenPipeError

    monkeypatch.setattr("sys.stdout.write", closed)
    monkeypatch.setattr("os.dup2", lambda *files: None)
    trainer = Trainer(make_config(TINY), tmp_path / "run")
    trainer.train()
    assert trainer.finished

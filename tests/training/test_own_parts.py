"""A run of parts of the user's own: env, networks, loss, logger, callbacks."""

from __future__ import annotations

import csv
import json
import time
from functools import partial
from types import SimpleNamespace

import pytest
import torch
from torch import nn
from torchrl.envs.utils import check_env_specs
from torchrl.record.loggers import CSVLogger

from tests.training.cart import (
    CartEnv,
    DoubledLoss,
    Recorder,
    make_bare_cart,
    make_cart,
    make_cart_networks,
)
from tests.training.states import differing
from torchrl_atr.cli import main
from torchrl_atr.envs.tasks import TASKS, riding
from torchrl_atr.training import Callback, CheckpointError, ConfigError, Trainer, load_checkpoint, load_run, make_config

SMALL = {
    "env.num_envs": 8,
    "ppo.rollout_steps": 4,
    "total_frames": 6 * 32,
    "compute.num_threads": 1,
    "compute.torch_threads": 1,
    "ppo.minibatches": 2,
    "ppo.smoothness_coeff": 0.0,
}
CARTS = {"make_env": make_cart, "make_networks": make_cart_networks}


def test_the_env_of_these_tests_is_valid():
    check_env_specs(make_cart(4))
    check_env_specs(make_bare_cart(4))


def end_after(iteration):
    return lambda metrics: metrics["iteration"] == iteration


def ends(folder, names):
    states = [load_checkpoint(folder / name) for name in names]
    for state in states:
        for clock in ("seconds", "provenance", "best_reward"):
            del state[clock]
    return states


@pytest.mark.parametrize("make_env", [make_cart, make_bare_cart])
def test_a_run_of_own_parts_goes_on_bit_for_bit_with_the_same_arguments(tmp_path, make_env):
    def parts():
        return {**CARTS, "make_env": make_env, "make_loss": DoubledLoss, "callbacks": [Recorder()]}

    config = make_config(SMALL)
    Trainer(config, tmp_path / "straight", **parts()).train()
    Trainer(config, tmp_path / "halves", **parts()).train(end_after(3))
    state = load_checkpoint(tmp_path / "halves")
    again = parts()
    resumed = Trainer(config, tmp_path / "halves", state, **again)
    (recorder,) = again["callbacks"]
    assert recorder.count == recorder.resumed_at == 3
    resumed.train()
    assert differing(*ends(tmp_path, ("straight", "halves"))) == []
    assert float(resumed.learner.loss.calls) == 6 * 2  # a buffer of the loss's own
    with (tmp_path / "halves" / "progress.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["mine"]) for row in rows] == [1, 2, 3, 4, 5, 6]
    assert "command_area" not in rows[0]
    assert {"reward/near", "loss_mine"} <= set(rows[0])
    origin = json.loads((tmp_path / "halves" / "run.json").read_text())
    assert origin["parts"]["make_networks"] == "tests.training.cart.make_cart_networks"


def test_hooks_are_called_in_order_and_change_what_is_learned_from(tmp_path):
    recorder, plain = Recorder(), []
    settings = {**SMALL, "total_frames": 32, "ppo.epochs": 1, "ppo.minibatches": 1}
    config, seen = make_config(settings), []
    Trainer(config, tmp_path / "plain", **CARTS).train(plain.append)
    Trainer(config, tmp_path / "run", **CARTS, callbacks=[recorder]).train(seen.append)
    steps = [f"{hook} {phase}" for phase in ("policy", "estimators") for hook in ("minibatch", "loss")]
    assert recorder.calls == [
        *("train_begin", "checkpoint", "batch", *steps, "iteration", "checkpoint", "train_end"),
    ]
    assert seen[0]["reward"] == pytest.approx(0.5 * plain[0]["reward"])
    assert seen[0]["loss_mine"] == 0.0


def test_a_callback_ends_a_run_and_what_it_reads_is_in_its_minibatches(tmp_path):
    class Once(Callback):
        in_keys = ("step_count",)
        seen = 0

        def on_minibatch(self, minibatch, phase):
            self.seen += int(minibatch["step_count"].sum() >= 0)
            return minibatch

        def on_iteration(self, metrics):
            return True

    once = Once()
    trainer = Trainer(make_config(SMALL), tmp_path, **CARTS, callbacks=[once])
    assert trainer.train() is None
    assert (trainer.iteration, once.seen) == (1, 2 * 2 + 2)


def test_a_logger_gets_what_progress_csv_gets(tmp_path):
    logger = CSVLogger("mine", log_dir=str(tmp_path / "logs"))
    Trainer(make_config(SMALL), tmp_path / "run", **CARTS, logger=logger).train()
    rows = (tmp_path / "logs" / "mine" / "scalars" / "train" / "loss_objective.csv").read_text().split()
    with (tmp_path / "run" / "progress.csv").open() as file:
        wanted = [(float(row["frames"]), float(row["loss_objective"])) for row in csv.DictReader(file)]
    found = [tuple(map(float, row.split(","))) for row in rows]
    assert found == [(frames, pytest.approx(loss, rel=1e-4)) for frames, loss in wanted]
    assert not (tmp_path / "run" / "tensorboard").exists()


@pytest.mark.parametrize("name", ["csv", "tensorboard", "mlflow", "wandb"])
def test_a_named_logger_gets_what_progress_csv_gets_and_is_closed(tmp_path, monkeypatch, name):
    made = []

    def make(*arguments, **options):
        made.append((arguments, options, Spy()))
        return made[-1][-1]

    monkeypatch.setattr("torchrl.record.loggers.get_logger", make)
    monkeypatch.setattr("torchrl.record.loggers.MLFlowLogger", make)
    monkeypatch.setattr("torchrl_atr.training.loggers.find_spec", lambda package: True)
    Trainer(make_config({**SMALL, "logging.logger": name}), tmp_path / "run", **CARTS).train()
    with (tmp_path / "run" / "progress.csv").open() as file:
        frames = [int(float(row["frames"])) for row in csv.DictReader(file)]
    assert len(made) == (name != "csv")
    for _, _, spy in made:
        assert spy.steps == frames
        assert spy.closed
        assert ("env" in spy.settings) == (name != "tensorboard")


class Spy:
    """Stands in for a logger of TorchRL, and for its experiment."""

    def __init__(self):
        self.steps, self.settings, self.closed, self.experiment = [], {}, False, self

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.closed = True

    def log_hparams(self, settings):
        self.settings = settings

    def log_metrics(self, metrics, step):
        assert "train/loss_objective" in metrics
        self.steps.append(step)


def test_tensorboard_shows_a_step_once_that_a_resumed_run_took_again(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    trainer = Trainer(make_config(SMALL), tmp_path, **CARTS)
    state = {}
    trainer.train(lambda metrics: state.update(load_checkpoint(tmp_path)) if metrics["iteration"] == 1 else None)
    assert state["frames"] == 0  # it is killed before the next one is written, say
    time.sleep(1.0)  # event files are read in the order of their names, which begin with a second
    Trainer(make_config(SMALL), tmp_path, state, **CARTS).train()
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    steps = [event.step for event in events.Scalars("train/loss_objective")]
    assert steps == sorted(set(steps)) != []


def test_a_run_of_own_parts_is_loaded_with_them_and_nothing_less(tmp_path, capsys):
    Trainer(make_config(SMALL), tmp_path, **CARTS).train()
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir() if file.is_file()}
    _, env, networks, _ = load_run(tmp_path, **CARTS, num_envs=3)
    assert env.rollout(5, networks.deployed_policy())["action"].shape == (3, 5, 1)
    missing = "was trained with make_env=tests.training.cart.make_cart and make_networks="
    for command in (["evaluate"], ["train", "--resume"], ["play"]):
        assert main([*command, str(tmp_path)]) == 2
        assert missing in (message := capsys.readouterr().err)
        assert "pass make_env=..., make_networks=... to" in message
    with pytest.raises(CheckpointError, match="trained with make_networks="):
        Trainer(make_config(SMALL), tmp_path / "new", begin_from=tmp_path, make_env=make_cart)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir() if file.is_file()} == before
    begun = Trainer(make_config(SMALL), tmp_path / "new", begin_from=tmp_path, **CARTS)
    for name, value in networks.state_dict().items():
        assert torch.equal(begun.learner.networks.state_dict()[name], value), name


def test_other_processes_make_the_env_too(tmp_path):
    recorder = Recorder()
    config = make_config({**SMALL, "compute.collector": "process", "compute.workers": 2, "total_frames": 2 * 32})
    trainer = Trainer(config, tmp_path, **CARTS, make_loss=DoubledLoss, callbacks=[recorder])
    trainer.train()
    assert (trainer.iteration, recorder.count) == (2, 2)


class Extra(DoubledLoss):
    def __init__(self, networks):
        super().__init__(networks)
        self.weight = nn.Parameter(torch.zeros(1))


class Lacking(Callback):
    def on_batch(self, batch):
        batch["seen"] = batch["next", "done"]


class Unsafe(Callback):
    def state_dict(self):
        return {"an": object()}


class Misnamed(Callback):
    in_keys = "reward"


@pytest.mark.parametrize("config", [SMALL, "run.toml", None])
def test_a_configuration_of_another_kind_is_refused(tmp_path, config):
    with pytest.raises(ConfigError, match="give a TrainConfig, such as make_config"):
        Trainer(config, tmp_path / "run")


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        (
            "dead_reckoned_velocity",
            "estimator.dead_reckoning=true reads 'dead_reckoned_velocity', which the env does not have; set it to f",
        ),
        (
            ("privileged", "tracking_forecast"),
            r"ppo.tracking_forecast=true reads \('privileged', 'tracking_forecast'\), which the env",
        ),
        (("privileged", "extrinsic"), r"env.reposition_feet=0.16 needs relative_position .*env.reposition_feet=0"),
        (("privileged", "extrinsic"), "do not fit the task 'riding_less' .*give make_networks= too"),
    ],
)
def test_a_task_that_lacks_what_a_setting_reads_is_named(tmp_path, monkeypatch, missing, message):
    def less(robot="a1"):
        task = riding(robot)
        kept = {key: group for key, group in task.observations.items() if key != missing}
        return task.replace(observations=kept)

    monkeypatch.setitem(TASKS._entries, "riding_less", less)
    more = {"env.reposition_feet": 0.0} if "make_networks" in message else {}
    with pytest.raises(ConfigError, match=message):
        Trainer(make_config({**SMALL, **more, "compute.num_threads": 1, "task.name": "riding_less"}), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def scheduled_cart(**arguments):
    """A cart whose task schedules a reward term that it does not have."""
    env = make_cart(**arguments)
    env.base_env.task = SimpleNamespace(reward_schedule={"steering_command": float})
    return env


@pytest.mark.parametrize(
    ("parts", "settings", "message"),
    [
        ({"make_env": 3}, {}, "make_env=3 cannot be called; give a function"),
        ({"make_env": lambda **_: None}, {}, r"make_env=.*<lambda> returned NoneType; return a torchrl.envs.EnvBase"),
        (
            {"make_env": lambda num_envs, **_: CartEnv(3)},
            {},
            r"of batch size \(3,\); it must be \(num_envs,\) = \(8,\)",
        ),
        (
            {"make_env": lambda **_: None},
            {"compute.collector": "process"},
            "cannot be pickled .* collector='process' sends it",
        ),
        ({"state": {"members": [{}]}}, {}, "was trained by several learners, which are gone; begin a new run with"),
        ({"make_env": make_cart}, {}, "networks do not fit the env of tests.training.cart.make_cart .* make_networks="),
        ({**CARTS, "make_networks": lambda env: nn.Linear(1, 1)}, {}, "Linear, which lacks rollout_policy, .*docs/own"),
        ({**CARTS, "make_loss": lambda networks: nn.Linear(1, 1)}, {}, "Linear, which lacks policy_loss"),
        ({**CARTS, "make_loss": Extra}, {}, "no optimiser trains the loss's parameter 'weight'"),
        ({**CARTS, "make_env": scheduled_cart}, {}, "the term 'steering_command', but .* are near, gentle"),
        (
            {"make_networks": nn.Linear(1, 1)},
            {},
            r"make_networks=Linear\(...\) is what is to be made; give what makes it",
        ),
        ({"callbacks": [Misnamed()]}, {}, "in_keys='reward': give a list of keys .of the callback 'Misnamed'"),
        ({"state": "runs/other"}, {}, r"state='runs/other'; give what load_checkpoint\(run\) returns"),
        ({"logger": "tensorboard"}, {}, "logger='tensorboard' lacks log_metrics; give one of torchrl.record"),
        ({}, {"logging.logger": "wandb"}, "logger='wandb' needs the package wandb: pip install wandb"),
        ({"callbacks": [print]}, {}, "print> is not a Callback object"),
        ({"callbacks": Recorder()}, {}, "give a list of Callback"),
        ({"callbacks": [Recorder(), Recorder()]}, {}, "two callbacks are called 'Recorder'; give one another `name`"),
        ({"callbacks": [Unsafe()]}, {}, "state_dict returned of the callback 'Unsafe' cannot be kept"),
    ],
)
def test_what_cannot_be_used_is_named_before_anything_is_written(tmp_path, parts, settings, message):
    with pytest.raises(ConfigError, match=message):
        Trainer(make_config({**SMALL, **settings}), tmp_path / "run", **parts)
    assert not (tmp_path / "run").exists()


def test_a_hook_that_returns_nothing_is_named(tmp_path):
    with pytest.raises(ConfigError, match="on_batch of the callback 'Lacking' returned None; return the TensorDict"):
        Trainer(make_config(SMALL), tmp_path, **CARTS, callbacks=[Lacking()]).train()


def test_a_hook_in_captured_steps_is_refused(monkeypatch, tmp_path):
    from torchrl_atr.training import TrainConfig

    monkeypatch.setattr(TrainConfig, "captures_graphs", property(lambda self: True))
    with pytest.raises(ConfigError, match=r"on_loss of the callback 'Recorder'.* CUDA graphs.*compute.compiled=false"):
        Trainer(make_config(SMALL), tmp_path / "run", **CARTS, callbacks=[Recorder()])


def test_a_schedule_of_the_envs_task_weighs_its_terms(tmp_path):
    class Task:
        reward_schedule = {"gentle": lambda progress: 1.0 + progress}  # noqa: RUF012

    def make_env(**arguments):
        env = make_cart(**arguments)
        env.base_env.task = Task()
        return env

    trainer = Trainer(make_config(SMALL), tmp_path, make_env=make_env, make_networks=make_cart_networks)
    assert trainer.learner.reward_schedule == Task.reward_schedule
    trainer.train()


def test_own_reward_terms_around_the_riding_env(tmp_path):
    from torchrl_atr.envs import RIDING_REWARDS, make_riding_env

    own = partial(make_riding_env, "a1", "single_board", rewards=RIDING_REWARDS)
    trainer = Trainer(make_config({**SMALL, "total_frames": 32}), tmp_path, make_env=own)
    trainer.train()
    assert trainer.curriculum is not None
    assert load_checkpoint(tmp_path)["model"]["robot"]
    assert load_run(tmp_path, make_env=own, num_envs=1)[1].batch_size == (1,)


def test_networks_that_explore_more_than_a_run_ends_with_are_refused_at_its_start(tmp_path):
    with pytest.raises(ConfigError, match=r"final_std=0\.01 must be above the floor .*, 0\.05; give a larger one"):
        Trainer(
            make_config(SMALL | {"exploration.final_std": 0.01, "exploration.min_std": 0.0}), tmp_path / "run", **CARTS
        )
    assert not (tmp_path / "run").exists()

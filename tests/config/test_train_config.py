"""Configurations: what is accepted, what is refused, how the refusal reads, and who wins where sources disagree."""

from __future__ import annotations

import json
import tomllib

import pytest

from torchrl_atr._settings import settings
from torchrl_atr.cli.train_options import parse_train
from torchrl_atr.config import EnvConfig, PPOConfig
from torchrl_atr.config.files import to_toml
from torchrl_atr.config.nested import to_text
from torchrl_atr.training import ConfigError, TrainConfig, make_config, make_env, parse_settings, read_config


def test_texts_become_what_the_setting_is():
    texts = {"ppo.gamma": "0.5", "total_frames": "1e6", "imports": "json,math", "estimator.dead_reckoning": "false"}
    config = make_config({"ppo": {"gamma": 0.9}, "env.num_envs": 8}, parse_settings(texts))
    assert (config.ppo.gamma, config.env.num_envs, config.total_frames) == (0.5, 8, 1_000_000)
    assert config.imports == ("json", "math")
    assert not config.estimator.dead_reckoning


CHANGED = make_config(
    {
        "ppo": {"gamma": 0.97, "critic_cells": [8, 4]},
        "task": {"rewards": {"heading_alignment": -2}, "randomization": {"payload": {"train": [0.0, 2.0]}}},
        "task.pushes.robot": 0.7,
        "task.interpretation.tilt_limit": 0.9,
        "estimator": {"name": "mlp", "arguments": {"cells": [8]}},
        "env.overspeed_margin": [],
    }
)


def test_a_configuration_survives_both_kinds_of_files(tmp_path):
    for name, text in (
        ("run.json", json.dumps(CHANGED.to_dict())),
        ("run.toml", to_toml(TrainConfig, CHANGED.to_dict())),
    ):
        (tmp_path / name).write_text(text)
        assert make_config(read_config(tmp_path / name)) == CHANGED


def test_a_file_says_what_each_setting_is():
    text = to_toml(TrainConfig, TrainConfig().to_dict())
    assert tomllib.loads(text) == TrainConfig().to_dict()
    for path, each in settings(TrainConfig).items():
        assert each.text, path
        assert " ".join(each.text.split()[:4]) in text, path


def test_the_documented_order_of_sources():
    assert TrainConfig().ppo.gae_lambda == 0.8
    assert make_config({"preset": "paper"}).ppo.entropy_coeff == 0.01
    assert make_config({"preset": "paper"}).ppo.epochs == 5
    assert make_config({"preset": "paper", "task.name": "walking"}).ppo.epochs == 3  # the task wins over the preset
    file = {"preset": "paper", "task": {"name": "walking"}, "ppo": {"epochs": 7, "minibatches": 2}}
    assert make_config(file).ppo.epochs == 7  # the file over both
    both = make_config(file, parse_train(["--ppo.epochs", "8", "--preset", "default"]).given)
    assert (both.ppo.epochs, both.ppo.minibatches, both.preset) == (8, 2, "default")  # the command line over the file


def test_every_setting_is_an_option():
    words, changed = [], dict.fromkeys(path for path in settings(TrainConfig) if path != "imports")
    for path in list(changed):
        each = settings(TrainConfig)[path]
        if isinstance(each.default, dict):
            del changed[path]
            continue
        value = each.default[:1] if isinstance(each.default, tuple) else each.default
        words += [f"--{path.replace('_', '-')}", to_text(value)]
        changed[path] = list(value) if isinstance(value, tuple) else value
    assert parse_train(words).given == changed


def test_weights_ranges_pushes_gains_and_questions_reach_the_env():
    words = (
        "--num-envs 2 --task.rewards.heading-alignment -2 --task.randomization.payload.train 0.5,0.6 "
        "--task.randomization.friction.test 0.1,0.2 --task.pushes.interval 0.1 --task.pushes.robot 0 --task.kp 50 "
        "--task.interpretation.relative-pose false --env.reposition-feet 0 --compute.num-threads 1"
    )
    config = make_config(parse_train(words.split(" ")).given)
    env = make_env(config)
    task = env.base_env.task
    assert task.rewards["heading_alignment"].weight == -2.0
    assert task.intrinsics["payload"].train == (0.5, 0.6)
    assert task.intrinsics["payload"].test == (0.0, 3.0)
    assert task.intrinsics["friction"].test == (0.1, 0.2)
    assert task.disturbances["push"].steps == 5
    assert task.robot.kp == 50.0
    assert env.observation_spec["privileged", "extrinsic"].shape == (2, 13)
    assert not make_config({"task.pushes.interval": 0.0}).make_task().disturbances


def test_steps_need_an_extrinsic_state_that_tells_where_feet_are():
    with pytest.raises(ConfigError, match=r"env.reposition_feet=0.16 needs relative_position.*env.reposition_feet=0"):
        make_config({"task.interpretation.relative_pose": False})
    assert make_config({"task.name": "walking"}).env.reposition_feet == 0.0


def test_walking_takes_gains_and_pushes_too():
    task = make_config({"task.name": "walking", "task.kd": 2.0, "task.pushes.interval": 1.0}).make_task()
    assert (task.robot.kd, task.disturbances["push"].steps) == (2.0, 50)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gama": 0.9}, r"unknown setting 'gama'; did you mean 'ppo.gamma', of the group ppo\?"),
        ({"gamma": 0.9}, r"unknown setting 'gamma'; did you mean 'ppo.gamma', of the group ppo\?"),
        ({"ppo.gama": 0.9}, r"unknown setting 'ppo.gama'; did you mean 'ppo.gamma', of the group ppo\?"),
        ({"ppo": {"num_envs": 3}}, r"unknown setting 'ppo.num_envs'; did you mean 'env.num_envs', of the group env\?"),
        ({"task.interpretation.tilt": 3}, r"did you mean 'task.interpretation.tilt_limit', of the group task.interp"),
        ({"tsk": {"name": "riding"}}, r"unknown setting 'tsk'"),
        ({"ppo": 3}, r"ppo=3: ppo is a group of settings; write ppo.NAME, or \[ppo\]"),
        ({"ppo.gamma": 1.5}, r"ppo.gamma=1.5 is out of range; choose a number in \[0, 0.99999\]"),
        ({"env.episode_seconds": 0.01}, r"env.episode_seconds=0.01 is out of range; .* in \[0.1, 1000000\] s$"),
        ({"ppo.gamma": float("nan")}, "ppo.gamma=nan is out of range"),
        ({"env.num_envs": "many"}, "env.num_envs='many' does not fit; give a whole number such as 512"),
        ({"env.num_envs": 2.5}, "env.num_envs=2.5 does not fit"),
        ({"task.robot": 3}, "task.robot=3 does not fit; give a text such as a1"),
        ({"estimator.dead_reckoning": "maybe"}, "dead_reckoning='maybe' does not fit; give true or false"),
        ({"roa.act_source": "guess"}, "act_source='guess' is unknown; choose one of privileged"),
        (
            {"exploration.init_std": 0.1, "exploration.min_std": 0.2},
            "min_std=0.2 must be below exploration.init_std=0.1",
        ),
        (
            {"task.rewards": {"headin_alignment": -1}},
            "task.rewards.headin_alignment=-1: .* did you mean 'heading_alignment'",
        ),
        ({"task.rewards": {"heading_alignment": "x"}}, "task.rewards={.*} does not fit; give a table"),
        (
            {"task.randomization": {"payload": {"train": [1.0, 0.5]}}},
            "task.randomization.payload: train=.* is no range",
        ),
        ({"task.randomization": {"mass": {"train": [0.5, 1.0]}}}, "task.randomization.mass: .* has no 'mass'"),
        ({"task.randomization": {"payload": {"tran": [0, 1]}}}, "unknown setting 'task.randomization.payload.tran'"),
        ({"env.overspeed_margin": [2.0]}, "env.overspeed_margin=.*: give two numbers"),
        ({"roa.latent_features": 15}, "roa.latent_features=15 must be even"),
        ({"task.robot": "a2"}, "unknown robot 'a2'; known: a1"),
        ({"task.transporter": "skateboard"}, "unknown transporter 'skateboard'; .*known: single_board"),
        ({"preset": "mine"}, "unknown preset 'mine'; known: default, paper, literal, legged_gym"),
    ],
)
def test_bad_settings_name_the_culprit_and_the_remedy(values, message):
    with pytest.raises(ValueError, match=message):
        make_config(values)


def test_groups_check_themselves():
    with pytest.raises(ConfigError, match=r"ppo.gamma=2.0 is out of range"):
        PPOConfig(gamma=2)
    with pytest.raises(ConfigError, match=r"env=.* is a group of settings; give EnvConfig"):
        TrainConfig(env=8)
    assert TrainConfig(env=EnvConfig(num_envs=4)) == make_config({"env.num_envs": 4})


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("missing.toml", None, "there is no configuration file"),
        ("broken.toml", "a = = 1", "is not valid TOML"),
        ("broken.json", "{", "is not valid JSON"),
        ("recipe.yaml", "a: 1", r"use a \.toml or \.json file"),
    ],
)
def test_bad_files(tmp_path, name, text, message):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_config(path)


def test_a_setting_that_the_task_does_not_take_is_refused():
    with pytest.raises(
        ConfigError, match=r"task.fall_weight=200.0: the task 'walking' has no fall_weight; leave it out"
    ):
        make_config({"task.name": "walking", "task.fall_weight": 200.0})
    for preset in ("paper", "default", "legged_gym"):
        assert make_config({"task.name": "walking", "preset": preset}).make_task().name == "walking"

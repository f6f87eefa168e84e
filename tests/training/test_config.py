"""Configurations: what is accepted, what is refused, and how the refusal reads."""

from __future__ import annotations

import json

import pytest

from torchrl_atr.training import ConfigError, TrainConfig, make_config, read_config


def test_values_and_overrides_with_the_override_winning():
    config = make_config({"gamma": 0.9, "num_envs": 8}, ["gamma=0.5", "total_frames=1e6", "imports=json,math"])
    assert (config.gamma, config.num_envs, config.total_frames) == (0.5, 8, 1_000_000)
    assert config.imports == ("json", "math")
    assert not make_config({}, ["dead_reckoning=false"]).dead_reckoning


def test_json_round_trip(tmp_path):
    path = tmp_path / "config.json"
    path.write_text(json.dumps(TrainConfig(robot="a1", gamma=0.97).to_dict()))
    assert make_config(read_config(path)) == TrainConfig(robot="a1", gamma=0.97)


def test_toml_file(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text("num_envs = 32\ngamma = 0.98\n")
    assert make_config(read_config(path)).num_envs == 32


@pytest.mark.parametrize(
    ("values", "overrides", "message"),
    [
        ({"gama": 0.9}, [], r"unknown setting 'gama'; did you mean 'gamma'\?"),
        ({"gamma": 1.5}, [], r"gamma=1.5 is out of range; choose a number in \[0, 0.99999\]"),
        ({"gamma": float("nan")}, [], "gamma=nan is out of range"),
        ({}, ["gamma"], "write it as key=value"),
        ({}, ["num_envs=many"], "num_envs='many' does not fit; give a whole number such as 512"),
        ({"num_envs": 2.5}, [], "num_envs=2.5 does not fit"),
        ({"robot": 3}, [], "robot=3 does not fit; give a text such as a1"),
        ({"dead_reckoning": "maybe"}, [], "dead_reckoning='maybe' does not fit; give true or false"),
        ({"act_source": "guess"}, [], "act_source='guess' is unknown; choose one of privileged"),
        ({"init_std": 0.1, "min_std": 0.2}, [], "min_std=0.2 must be below init_std=0.1"),
        ({"robot": "a2"}, [], "unknown robot 'a2'; known: a1"),
        ({"transporter": "skateboard"}, [], "unknown transporter 'skateboard'; .*known: single_board"),
        ({"profile": "mine"}, [], "unknown profile 'mine'; known: default, literal, ancestor"),
    ],
)
def test_bad_settings_name_the_culprit_and_the_remedy(values, overrides, message):
    with pytest.raises(ValueError, match=message):
        make_config(values, overrides)


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

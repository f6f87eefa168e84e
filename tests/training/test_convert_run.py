"""Runs of earlier versions are converted to what they would be if they had been trained today."""

from __future__ import annotations

import json
import tomllib

import pytest
import torch

from scripts import convert_run
from tests.training.states import SMALL, differing
from torchrl_atr.config.nested import flat
from torchrl_atr.runs.checkpoint import VERSION
from torchrl_atr.runs.restoring import SINCE
from torchrl_atr.training import CheckpointError, Trainer, load_checkpoint, load_run, make_config

OLD_NAMES = {  # of version 2, in version 1
    "exploration.raw": "backbone.std.raw",
    "exploration.basis": "backbone.noise_basis",
    "backbone.output_map": "backbone.head",
    "extrinsic_estimator.side_norms.0": "extrinsic_estimator.side_norm",
    "critic.input_norms.0": "critic.outlook_norm",
}


def as_version_1(state):
    """The state as it was saved before exploration was a module of its own; the optimisers' are the same."""
    for part in ("networks", "deployed"):
        renamed = state["learner"][part]
        for new, old in OLD_NAMES.items():
            assert any(name.startswith(new) for name in renamed), new
            renamed = {name.replace(new, old): value for name, value in renamed.items()}
        state["learner"][part] = renamed
    state["config"] = old_settings(state["config"])
    for option in ("forward_only", "still", "turning", "straight"):
        del state["curriculum"]["grid"][option]
    return {**state, "version": 1}


def old_settings(settings):
    """The settings as version 1 named them, flat."""
    renamed = {"steering_weight_peak": "steering_emphasis", "steering_weight_end": "final_emphasis"}
    new = ("tracking_forecast", "task")
    given = flat(settings)
    old = {name: given[path] for name, path in convert_run.NESTED.items() if name not in renamed.values()}
    old |= {"profile": "default", "runaway_speed": 2.0, "runaway_yaw_rate": 2.0, "student_fraction": 0.5}
    return {renamed.get(name, name): value for name, value in old.items() if name not in new}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    Trainer(make_config({**SINCE, **SMALL, "total_frames": 2 * 64}), folder).train()
    return folder


@pytest.fixture
def old_run(run, tmp_path):
    """The same run as version 1 left it."""
    folder = tmp_path / "old"
    folder.mkdir()
    for name in ("checkpoint.pt", "previous.pt"):
        torch.save(as_version_1(torch.load(run / name, weights_only=True)), folder / name)
    settings = old_settings(tomllib.loads((run / "config.toml").read_text()))
    (folder / "config.json").write_text(json.dumps(settings))
    (folder / "progress.csv").write_text("frames\n")
    return folder


def test_every_version_has_a_step():
    assert len(convert_run.CONVERSIONS) == VERSION - 1


@pytest.mark.parametrize("copied", [True, False])
def test_a_converted_run_is_the_one_of_today(run, old_run, tmp_path, capsys, copied):
    target = tmp_path / "new" if copied else old_run
    assert convert_run.main([str(old_run), str(target)] if copied else [str(old_run)]) == 0
    assert f"checkpoint.pt, previous.pt converted; all is of version {VERSION}" in capsys.readouterr().out
    for name in ("checkpoint.pt", "previous.pt"):
        today = load_checkpoint(run / name)  # but for the episodes that were under way
        assert not differing(load_checkpoint(target / name), {**today, "collection": {}})
    assert (target / "config.toml").read_text() == (run / "config.toml").read_text()
    assert not (target / "config.json").exists()
    assert (target / "progress.csv").read_text() == "frames\n"
    assert load_checkpoint(target)["version"] == VERSION
    load_run(target, num_envs=1)
    if copied:
        with pytest.raises(CheckpointError, match=r"convert_run\.py"):
            load_checkpoint(old_run)


def test_what_is_converted_already_stays_as_it_is(old_run, capsys):
    assert convert_run.convert_run(old_run) == ["checkpoint.pt", "previous.pt"]
    before = (old_run / "checkpoint.pt").read_bytes()
    assert convert_run.main([str(old_run)]) == 0
    assert "nothing converted" in capsys.readouterr().out
    assert (old_run / "checkpoint.pt").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda state: state.update(version=99), "version 99 is unknown here"),
        (lambda state: state.pop("learner"), "holds no 'learner', as version 1 does"),
    ],
)
def test_what_cannot_be_converted_is_named_and_left(old_run, capsys, change, message):
    state = torch.load(old_run / "previous.pt", weights_only=True)
    change(state)
    torch.save(state, old_run / "previous.pt")
    before = (old_run / "checkpoint.pt").read_bytes()
    assert convert_run.main([str(old_run)]) == 2
    error = capsys.readouterr().err
    assert f"{old_run / 'previous.pt'} cannot be converted: " in error
    assert message in error
    assert (old_run / "checkpoint.pt").read_bytes() == before


def test_a_folder_without_checkpoints_and_a_copy_in_the_way_are_named(old_run, tmp_path, capsys):
    assert convert_run.main([str(tmp_path)]) == 2
    assert f"there is no checkpoint in {tmp_path}" in capsys.readouterr().err
    assert convert_run.main([str(old_run), str(tmp_path)]) == 2
    assert f"{tmp_path} exists" in capsys.readouterr().err


@pytest.mark.parametrize("profile", ["literal", "ancestor"])
def test_a_profile_becomes_a_preset_and_its_answers(profile):
    config = make_config(convert_run.nested({"profile": profile, "gamma": 0.9, "retry": 0.0, "runaway_speed": 1.0}))
    assert config.preset == {"ancestor": "legged_gym"}.get(profile, profile)
    assert config.task.interpretation.driven_smoothness is (profile == "ancestor")
    assert config.task.interpretation.relative_mass is (profile == "ancestor")
    assert (config.ppo.gamma, config.env.failed_episode_replay) == (0.9, 0.0)
    assert config.env.overspeed_margin == (1.0, 2.0)
    assert config.ppo.kl_stop == 5.0  # as it was, whatever the preset says


@pytest.mark.parametrize("settings", [{"rest_share": 0.2}, {"student_fraction": 0.3}, {"profile": "mine"}])
def test_a_setting_that_is_gone_is_named(settings):
    with pytest.raises(CheckpointError, match=f"{next(iter(settings))}.* has no counterpart"):
        convert_run.nested(settings)

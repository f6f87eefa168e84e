"""Contents of a bundle, equality of its policy with the run's, and refusal of spoilt bundles."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

import torchrl_atr
from torchrl_atr.cli import commands, main
from torchrl_atr.cli.parser import build_parser
from torchrl_atr.deploy import BundleError, PolicyRunner, export, policies, read_manifest, verify
from torchrl_atr.deploy import manifest as manifests
from torchrl_atr.deploy.card import card, check_scorecard
from torchrl_atr.deploy.episode import ROBOTS as RECORDED
from torchrl_atr.deploy.episode import STEPS
from torchrl_atr.deploy.export import LARGEST, export_run
from torchrl_atr.deploy.manifest import EPISODE, MANIFEST, POLICY, SCENE, SCHEMA, WEIGHTS, report_home
from torchrl_atr.deploy.reports import copy_reports
from torchrl_atr.deploy.weights import write_weights
from torchrl_atr.envs.models import ROBOTS
from torchrl_atr.envs.models.leg_kinematics import with_stance
from torchrl_atr.modules import CommandClippedPolicy
from torchrl_atr.training import Trainer, load_checkpoint, load_run, make_config
from torchrl_atr.viewer import Session, Setup

pytestmark = pytest.mark.usefixtures("undrawn")

RUN = Path(__file__).parents[2] / "results" / "a1-single_board"


def test_it_is_small_and_acts_as_torch_does(bundle):
    assert sum(file.stat().st_size for file in bundle.rglob("*") if file.is_file()) < LARGEST
    found = verify(bundle)
    assert found.error < 1e-4
    assert (found.steps, found.robots) == (STEPS, RECORDED)
    assert found.resets >= 3
    assert main(["verify", str(bundle)]) == 0


def test_the_episode_has_commands_beyond_the_range_and_starts_of_single_robots(bundle):
    with np.load(bundle / EPISODE) as episode:
        assert np.abs(episode["command"]).max() > read_manifest(bundle)["command"]["limits"]["max_speed"]
        assert episode["start"][0].all()
        assert (episode["start"][1:].sum(1) == 1).any()


def test_the_manifest_says_what_the_robot_and_its_task_are(bundle):
    manifest, robot = read_manifest(bundle), with_stance(ROBOTS.get("a1"), *make_config({}).task.stance)
    joints = manifest["joints"]
    assert [joint["name"] for joint in joints] == list(robot.joints)
    assert [joint["q0"] for joint in joints] == list(robot.q0)
    assert {joint["kp"] for joint in joints} == {robot.kp}
    assert manifest["robot"]["action_scale"] == robot.action_scale
    assert manifest["control"]["rate_hz"] == 50
    assert sum(each["size"] for each in manifest["observation"]) == 49
    assert manifest["policy"]["inputs"]["history"] == [10, 49]
    assert [each["name"] for each in manifest["observation"]][-3:] == ["action", "support_tilt", "command"]
    assert all(each["frame"] and each["unit"] for each in manifest["observation"])
    assert manifest["training"] == json.loads((RUN / "run.json").read_text())
    noise = {each["name"]: each["trained_with"]["noise_std"] for each in manifest["sensors"]}
    assert noise["joint_position"] == 0.005


def test_the_model_states_its_opset_and_producer_and_no_folder_of_this_machine(bundle):
    model, manifest = onnx.load(bundle / POLICY), read_manifest(bundle)["policy"]
    assert model.opset_import[0].version == manifest["opset"]
    assert f"{model.producer_name} {model.producer_version}" == manifest["producer"]
    assert {each.name for each in model.graph.input} == set(manifest["inputs"])
    for file in (POLICY, SCENE, MANIFEST):
        assert str(RUN.parents[1]).encode() not in (bundle / file).read_bytes()


def test_the_card_has_the_scorecard(bundle):
    card, scorecard = (bundle / "README.md").read_text(), json.loads((RUN / "scorecard.json").read_text())
    assert scorecard["run"]["command"] in card
    survival = scorecard["evaluations"]["endurance"]["survival"]
    assert f"{survival:.1%}" in card
    assert read_manifest(bundle)["figures"]["endurance"]["survival"] == survival


def test_its_weights_are_the_deployed_ones_of_the_run(bundle):
    saved, run = (load_checkpoint(folder)["learner"]["deployed"] for folder in (bundle, RUN))
    assert saved.keys() == run.keys()
    critic = {name for name in run if name.startswith("critic.net.")}  # in half precision
    assert critic
    assert all(torch.equal(saved[name], run[name]) for name in run.keys() - critic)
    for name in critic:
        torch.testing.assert_close(saved[name], run[name], rtol=1e-3, atol=1e-6)


def test_it_is_loaded_as_a_policy_with_its_env(bundle):
    policy, make_env = torchrl_atr.load_policy(bundle)
    assert isinstance(policy, CommandClippedPolicy)
    assert not any(module.training for module in policy.modules())
    assert set(policy.in_keys) == {"history", "dead_reckoned_velocity", "observation"}
    env = make_env(num_envs=2, seed=0, num_threads=1)
    first = env.reset()
    assert torch.equal(policy(first.clone())["action"], policy(first.clone())["action"])
    whole = load_run(RUN, num_envs=1)[2].deployed_policy()
    torch.testing.assert_close(policy(first.clone())["action"], whole(first.clone())["loc"].detach())


def test_an_installed_bundle_is_a_name_wherever_a_run_is(bundle, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "policies").mkdir()
    (tmp_path / "policies" / "mine").symlink_to(bundle)
    monkeypatch.setattr(manifests.resources, "files", lambda package: tmp_path)
    assert list(policies()) == ["mine"]
    assert main(["list", "policies"]) == 0
    assert "mine" in capsys.readouterr().out
    few = ["--max-speed", "0", "--max-yaw-rate", "0", "--robots-per-command", "1"]
    assert main(["evaluate", "mine", *few, "--output", "report"]) == 0
    applied = json.loads((tmp_path / "report" / "metrics.json").read_text())["evaluation"]["command_range"]
    assert applied == read_manifest(bundle)["command"]["limits"]
    assert main(["evaluate", "mine", *few, "--command-range", "record"]) == 2
    assert "record it in the run, and export that" in capsys.readouterr().err
    tiny = ["--num-envs", "2", "--ppo.rollout-steps", "2", "--ppo.minibatches", "1", "--total-frames", "4"]
    plain = ["--compute.compiled", "false", "--compute.num-threads", "1"]
    assert main(["train", "--from", "mine", *tiny, *plain, "--output", "finer"]) == 0
    assert main(["train", "--resume", str(bundle)]) == 2
    assert "begin a new run with --from" in capsys.readouterr().err
    assert main(["train", "--resume", "mine"]) == 2
    assert "begin a new run with --from" in capsys.readouterr().err
    assert PolicyRunner("mine").manifest["name"] == "a1-single_board"
    for words in (["play"], ["view"], ["demo"], ["verify"], ["navigate"], ["compare", "--output", "x"]):
        arguments = build_parser().parse_args([words[0], "mine", *words[1:]])
        given = {getattr(arguments, name, None) for name in ("run", "policy", "bundle")}
        assert tmp_path / "policies" / "mine" in given
    assert main(["export", "mine", "--output", "other"]) == 2
    assert "bundle" in capsys.readouterr().err
    assert main(["plot", "ours=mine", "--output", "figures"]) == 0
    drawn = [Path(line).stem for line in capsys.readouterr().out.split()]
    assert drawn == ["learning_curves", "endurance", "command_area"]
    assert report_home(tmp_path / "policies" / "mine") == Path("runs/policies/a1-single_board")
    session = Session(Setup(tmp_path / "policies" / "mine"))
    session.steer(1.0, 0.0)
    assert session.step().actual.shape == (2,)


@pytest.mark.parametrize("name", policies())
def test_an_installed_policy_is_whole_small_and_the_committed_run(name):
    folder = policies()[name]
    manifest = read_manifest(folder)
    assert verify(folder).error < 1e-4
    assert sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) <= LARGEST
    results = Path(__file__).parents[2] / "results"
    if manifest["task"] == "walking":
        robots = json.loads((results / "walking" / "walking.json").read_text())["robots"]
        assert manifest["training"] == robots[manifest["robot"]["name"]]["run"]
        return
    assert manifest["training"] == json.loads((results / name / "run.json").read_text())
    measured = json.loads((results / name / "scorecard.json").read_text())["evaluations"]["endurance"]
    assert manifest["figures"]["endurance"]["survival"] == measured["survival"]


def test_reports_of_another_training_stay_behind(tmp_path):
    run, folder = tmp_path / "run", tmp_path / "bundle"
    for protocol, frames in {"endurance": 2, "tracking": 1}.items():
        (run / protocol).mkdir(parents=True)
        (run / protocol / "metrics.json").write_text(json.dumps({"run": {"frames": frames}}))
    (run / "progress.csv").write_text("frames\n" + "\n".join(str(row) for row in range(1200)))
    folder.mkdir()
    copy_reports(run, folder, {"frames": 2})
    assert sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.*")) == [
        "endurance/metrics.json",
        "progress.csv",
    ]
    assert len((folder / "progress.csv").read_text().split()) == 1 + 200  # every sixth row


def _remove(folder):
    (folder / POLICY).unlink()


def _flip(folder):
    data = bytearray((folder / WEIGHTS).read_bytes())
    data[-1] ^= 1
    (folder / WEIGHTS).write_bytes(bytes(data))


def _edit(folder):
    (folder / MANIFEST).write_text((folder / MANIFEST).read_text().replace('"kp": 40.0', '"kp": 80.0'))


def _cut(folder):
    (folder / MANIFEST).write_text((folder / MANIFEST).read_text()[:100])


@pytest.mark.parametrize(
    ("spoil", "culprit", "remedy"),
    [
        (_remove, "lacks policy.onnx", "copy the whole folder"),
        (_flip, "weights.safetensors", "copy the bundle again"),
        (_edit, "was changed after the export", "copy the bundle again"),
        (_cut, "is not JSON", "export it anew"),
        (lambda folder: (folder / MANIFEST).unlink(), "manifest.json is missing", "torchrl-atr export"),
    ],
)
def test_a_spoilt_bundle_is_refused(copied, spoil, culprit, remedy):
    spoil(copied)
    for use in (verify, PolicyRunner, read_manifest):
        with pytest.raises(BundleError, match=culprit) as refusal:
            use(copied)
        assert remedy in str(refusal.value)


def test_a_spoilt_bundle_is_refused_by_commands(copied, capsys):
    _flip(copied)
    for words in (["verify"], ["play"], ["evaluate"], ["train", "--from"]):
        assert main([*words, str(copied)]) == 2
        assert "is not the file that was exported" in capsys.readouterr().err


def test_other_versions_and_schemas_are_refused(rewritten):
    with pytest.raises(BundleError, match=r"version 3; this code reads version 2: use the torchrl_atr that wrote it"):
        read_manifest(rewritten(lambda manifest: manifest.update(version=3)))
    with pytest.raises(BundleError, match="schema 'mine', not"):
        read_manifest(rewritten(lambda manifest: manifest.update(schema="mine", version=2)))


def test_another_policy_is_found_by_verify(copied):
    with np.load(copied / EPISODE) as episode:
        values = dict(episode)
    values["action"][50] += 0.01
    np.savez_compressed(copied / EPISODE, **values)
    manifest = json.loads((copied / MANIFEST).read_text())
    manifest["files"][EPISODE] = manifests.sha256(copied / EPISODE)
    (copied / MANIFEST).write_text(json.dumps(manifests.seal(manifest)))
    with pytest.raises(BundleError, match=r"acts otherwise than torch, by 0\.01"):
        verify(copied)


def test_another_robot_of_that_name_is_refused(bundle, monkeypatch):
    heavier = dataclasses.replace(ROBOTS.get("a1"), kp=60.0)
    monkeypatch.setitem(ROBOTS._entries, "a1", heavier)
    with pytest.raises(torchrl_atr.training.CheckpointError, match=r"another robot 'a1' .*kp: 40 then, 60 now"):
        torchrl_atr.load_policy(bundle)


@pytest.fixture
def tiny_run(tmp_path):
    def make(**settings):
        tiny = {"env.num_envs": 2, "total_frames": 8, "ppo.rollout_steps": 2, "ppo.minibatches": 1}
        Trainer(make_config({**tiny, "compute.num_threads": 1, **settings}), tmp_path / "run").save()
        return tmp_path / "run"

    return make


def test_scripted_steps_are_part_of_the_policy(tmp_path, tiny_run):
    """The actions of the episode are those that were carried out, steps included."""
    parity = export_run(tiny_run(**{"env.reposition_feet": 0.02}), tmp_path / "steps")
    assert parity.error < 1e-4
    states = read_manifest(tmp_path / "steps")["policy"]["state"]
    assert [each["shape"] for each in states if each["input"] == "memory"] == [[34]]
    with np.load(tmp_path / "steps" / EPISODE) as episode:
        assert np.abs(np.diff(episode["action"], axis=0)).max() > 0.05  # an untrained policy alone hardly moves


def test_what_cannot_be_exported_is_refused_and_leaves_nothing(bundle, tmp_path, capsys):
    output = tmp_path / "out"
    assert main(["export", str(bundle), "--output", str(output)]) == 2
    assert "is a bundle already" in capsys.readouterr().err
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "notes.txt").touch()
    assert main(["export", str(RUN), "--output", str(taken)]) == 2
    assert "holds something else" in capsys.readouterr().err
    for text in ('{"name": "my web app"}', json.dumps({"schema": SCHEMA, "files": {}})):
        (taken / MANIFEST).write_text(text)  # not a bundle's, and that of one with a file more
        assert main(["export", str(RUN), "--output", str(taken)]) == 2
        assert "holds something else" in capsys.readouterr().err
    assert not output.exists()
    assert {path.name for path in tmp_path.iterdir()} == {"taken"}
    assert (taken / "notes.txt").exists()


def test_a_bundle_is_replaced_whole_or_not_at_all(tmp_path, tiny_run, monkeypatch):
    run, folder = tiny_run(), tmp_path / "mine"
    export_run(run, folder)
    before = (folder / MANIFEST).read_text()
    move = os.replace

    def stopped_between(source, target):
        if str(source).endswith(".part"):
            raise KeyboardInterrupt
        move(source, target)

    monkeypatch.setattr(export.os, "replace", stopped_between)
    with pytest.raises(KeyboardInterrupt):
        export_run(run, folder)
    assert (folder / MANIFEST).read_text() == before
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    export_run(run, "mine")
    assert {path.name for path in tmp_path.iterdir() if path != run} == {"mine"}


def test_the_evaluation_that_a_run_holds_goes_with_its_bundle(tmp_path):
    (tmp_path / "run").mkdir()
    report = {"protocol": "tracking", "run": {"seed": 1}, "survival": 1.0}
    (tmp_path / "run" / "metrics.json").write_text(json.dumps(report))
    (tmp_path / "bundle").mkdir()
    copy_reports(tmp_path / "run", tmp_path / "bundle", {"seed": 1})
    assert json.loads((tmp_path / "bundle" / "tracking" / "metrics.json").read_text()) == report
    assert not (tmp_path / "bundle" / "endurance").exists()


def test_a_policy_that_acts_otherwise_than_torch_is_not_exported(bundle, tmp_path, monkeypatch):
    """The weights of the bundle are those that are compared, too."""
    policy = read_manifest(bundle)["policy"]

    def copy_onnx(step, env, folder):
        (folder / POLICY).write_bytes((bundle / POLICY).read_bytes())
        return policy

    def write_other(folder, state):
        weights = dict(state["learner"]["deployed"])
        weights["backbone.net.6.even.bias"] = weights["backbone.net.6.even.bias"] + 0.01
        write_weights(folder, {**state, "learner": {**state["learner"], "deployed": weights}})

    monkeypatch.setattr(export, "_write_onnx", copy_onnx)
    monkeypatch.setattr(export, "write_weights", write_other)
    with pytest.raises(BundleError, match="acts otherwise than torch"):
        export_run(RUN, tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_a_report_of_a_bundle_is_not_written_into_it(bundle):
    asked = {"run": bundle, "command_range": "apply", "protocol": "endurance", "output": None}
    arguments = argparse.Namespace(**asked, robot=None, transporter=None)
    assert commands._report_folder(arguments) == Path("runs/policies/a1-single_board/endurance")


def test_the_card_has_the_sweeps_that_were_measured(bundle, tmp_path):
    (tmp_path / "robustness").mkdir()
    row = {"survival": 0.25, "survival_interval": [0.1, 0.5], "value": 9.0, "region": "beyond"}
    sweep = {"unit": "kg", "training": [0.0, 1.0], "test": None, "rows": [row], "breaks_at": [9.0]}
    metrics = {"n": 20, "seconds": 20.0, "command_seconds": 5.0, "push_seconds": 3.0, "baseline": row}
    report = {**metrics, "parameters": {"payload": sweep}, "run": {"seed": 1}}
    (tmp_path / "robustness" / "metrics.json").write_text(json.dumps(report))
    text = card(tmp_path, read_manifest(bundle))
    assert "| payload | - | - | 25% [10%, 50%] at 9 kg | 9 kg |" in text
    check_scorecard(tmp_path, {"seed": 1})
    with pytest.raises(torchrl_atr._errors.UserError, match=r"robustness/metrics\.json is of another training"):
        check_scorecard(tmp_path, {"frames": 5})


def test_a_scorecard_of_another_training_is_refused(tiny_run, tmp_path):
    run = tiny_run()
    (run / "scorecard.json").write_text((RUN / "scorecard.json").read_text())
    with pytest.raises(torchrl_atr._errors.UserError, match=r"scorecard\.json is of another training"):
        export_run(run, tmp_path / "out")

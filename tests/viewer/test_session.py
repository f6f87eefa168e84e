"""A session without a page: what is steered, pushed, loaded and changed has its physical effect, and no other."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import torch

from torchrl_atr._errors import UserError
from torchrl_atr.modules import CommandRange
from torchrl_atr.runs.checkpoint import NAME, save_checkpoint
from torchrl_atr.training import CheckpointError, load_checkpoint
from torchrl_atr.viewer import Session, Setup

GRAVITY = 9.81


def body_speed(session):
    """Horizontal velocity of the trunk in the world, m/s, (2,)."""
    engine = session.env.base_env.engine
    dof = engine.scene.layout.root_dof
    return engine.qvel[session.followed, dof : dof + 2].clone().numpy()


def test_a_command_is_approached_from_the_next_step_and_clipped_to_the_grid(session):
    session.steer(0.8, -0.4)
    session.step()
    assert session.step().command == pytest.approx([0.03, -0.01])  # 1.5 m/s² and 0.5 rad/s²
    for _ in range(39):
        reading = session.step()
    assert reading.command == pytest.approx([0.8, -0.4])
    session.steer(1e3, -1e3)
    bounds = session.env.curriculum.grid.bounds
    assert session.command == pytest.approx((bounds[0], -bounds[1]))


def test_the_trained_policy_follows_a_command(trained):
    session = Session(Setup(trained))
    session.steer(1.5, 0.0)
    for _ in range(120):
        reading = session.step()
    assert 0.5 < reading.actual[0] < 2.0
    assert reading.estimated[0] == pytest.approx(reading.actual[0], abs=0.5)
    assert session.falls == 0
    assert len(session.record) == 120
    # from rest, forwards: the distance is the integral of the speed
    distance = float(session.poses.read().places[0, 0])
    assert distance == pytest.approx(session.record["actual"][:, 0].sum() * 0.02, rel=0.1)


def test_a_push_changes_the_velocity_along_the_heading(session):
    before = body_speed(session)
    session.push(0.5, -0.2)
    heading = session.poses.read().headings[0]
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    assert body_speed(session) - before == pytest.approx(turn @ [0.5, -0.2], abs=0.02)


def test_a_payload_is_carried_at_once_and_after_a_reset_and_moves_nothing_else(session):
    session.step()
    weight, engine = session.step().weight, session.env.base_env.engine
    state = engine.get_state()
    session.set_parameter("payload", 2.5)
    for name, value in engine.get_state().items():
        assert torch.equal(value, state[name]), name
    assert session.step().weight == pytest.approx(weight + 2.5 * GRAVITY, rel=1e-3)
    assert session.parameters["payload"] == pytest.approx((0.0, 3.0, 2.5))
    session.reset()
    assert session.step().weight == pytest.approx(weight + 2.5 * GRAVITY, rel=1e-3)
    with pytest.raises(UserError, match="'com_shift'"):
        session.set_parameter("com_shift", 0.1)


def test_a_robot_that_falls_starts_anew_with_its_payload(session):
    session.set_parameter("friction", 0.7)
    for _ in range(300):
        session.push(3.0, 0.0)
        session.step()
        if session.falls:
            break
    assert session.falls == 1
    assert session.reading.fell
    assert session.parameters["friction"][2] == pytest.approx(0.7)
    assert session.step().rewards["termination"] == 0.0


def test_robots_differ_and_any_of_them_can_be_followed(session):
    session.change(robots=3)
    payloads = []
    for row in range(3):
        session.follow(row)
        payloads.append(session.parameters["payload"][2])
    assert len(set(payloads)) == 3
    session.set_parameter("payload", 3.0)
    session.follow(0)
    assert session.parameters["payload"][2] == pytest.approx(payloads[0])
    assert session.poses.read().positions.shape[0] == 3
    with pytest.raises(UserError, match="no robot 4"):
        session.follow(3)


def test_the_policy_acts_on_the_truth_or_on_estimates(session):
    session.step()
    time, builds = session.time, session.builds
    session.change(source="privileged")
    assert "history" not in session._policy.in_keys
    reading = session.step()
    assert np.isfinite(reading.estimate).all()  # estimates are shown all the same
    assert (session.time > time, session.builds) == (True, builds)  # the ride went on
    session.change(source="estimated")
    assert ("privileged", "extrinsic") not in session._policy.in_keys


@pytest.mark.parametrize("source", ["estimated", "privileged"])
def test_commands_are_clipped_to_the_policys_range_whatever_it_acts_on(session, source):
    session.networks.command_range = CommandRange(0.0, 0.0)
    session.change(source="privileged" if source == "estimated" else "estimated")
    session.change(source=source)
    still, fast = (session._td.clone() for _ in range(2))
    fast["command"][:] = fast["observation"][:, -2:] = torch.tensor([2.0, 1.0])
    assert torch.equal(session._policy(still)["loc"], session._policy(fast)["loc"])


def test_sensors_and_a_broken_policy(session, tmp_path):
    session.change(sensors="realistic")
    assert session.sensors == "realistic"
    builds = session.builds
    for change, message in (({"sensors": "perfect"}, "unknown sensor set"), ({"policy": tmp_path}, "no checkpoint")):
        with pytest.raises(UserError, match=message):
            session.change(**change)
    session.step()
    assert (session.builds, session.sensors) == (builds, "realistic")


def test_a_new_checkpoint_is_loaded(run, tmp_path):
    own = tmp_path / "run"
    shutil.copytree(run, own)
    session = Session(Setup(own))
    assert not session.refresh()
    state = load_checkpoint(own)
    state.pop("version")
    name = next(iter(dict(session.networks.backbone.named_parameters())))
    learner = state["learner"]
    for weights in (learner["networks"], learner.get("deployed", {})):
        if f"backbone.{name}" in weights:
            weights[f"backbone.{name}"] = weights[f"backbone.{name}"] + 1.0
    before = dict(session.networks.backbone.named_parameters())[name].detach().clone()
    save_checkpoint(own / NAME, {**state, "frames": 1234})
    assert session.refresh()
    assert session.frames == 1234
    assert torch.allclose(dict(session.networks.backbone.named_parameters())[name], before + 1.0)
    (own / NAME).write_bytes(b"half a file")
    (own / "previous.pt").unlink(missing_ok=True)
    with pytest.raises(CheckpointError):
        session.refresh()
    session.step()


def test_walking_is_shown_too(tmp_path):
    from torchrl_atr.training import Trainer, make_config

    tiny = {"task.name": "walking", "env.num_envs": 2, "total_frames": 8, "ppo.rollout_steps": 2, "ppo.minibatches": 1}
    Trainer(make_config({**tiny, "compute.num_threads": 1}), tmp_path).save()
    session = Session(Setup(tmp_path))
    session.steer(-1.0, 0.1)
    assert session.command[0] == 0.0  # forward only
    assert session.step().tilt.tolist() == [0.0, 0.0]
    with pytest.raises(UserError):
        session.set_parameter("platform_mass", 0.1)

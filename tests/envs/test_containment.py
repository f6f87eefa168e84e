"""What is no number ends as described: contained, named with its env id, dumped; the other robots do not notice."""

from __future__ import annotations

import dataclasses
import logging

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr._errors import InputError
from torchrl_atr.envs import ROBOTS, QuadrupedEnv, RidingEnv, make_task
from torchrl_atr.envs.recorder import load_dump
from torchrl_atr.envs.tasks import ObservationTerm, riding, walking
from torchrl_atr.evaluation import replay_failure

BAD, STEP = 2, 7
OTHERS = [0, 1, 3]


def spoil_simulation(env, monkeypatch):
    env.engine.qpos[BAD, env.scene.layout.joint_qpos[4]] = torch.nan


def spoil_observation(env, monkeypatch):
    observations = env.runner.terms.observations
    term = observations.groups["proprio"]["angular_velocity"]

    def spoiled(context):
        values = term.function(context).clone()
        values[BAD, 2] = torch.nan
        return values

    monkeypatch.setitem(
        observations.groups, "proprio", {**observations.groups["proprio"], "angular_velocity": ObservationTerm(spoiled)}
    )


def spoil_rewards(env, monkeypatch, spoil):
    """Have ``spoil(reward, terms)`` change what a step scores."""
    compute = type(env.runner.terms.rewards).__call__

    def spoiled(rewards, context):
        reward, terms = compute(rewards, context)
        spoil(reward, terms)
        return reward, terms

    monkeypatch.setattr(type(env.runner.terms.rewards), "__call__", spoiled)


def spoil_term(env, monkeypatch):
    row = list(env.runner.terms.rewards.terms).index("joint_torque")
    spoil_rewards(env, monkeypatch, lambda reward, terms: terms[row, BAD].fill_(torch.nan))


def spoil_reward(env, monkeypatch):
    spoil_rewards(env, monkeypatch, lambda reward, terms: reward[BAD].fill_(torch.inf))


def ride(env, monkeypatch, spoil=None, steps=STEP + 1):
    """Random actions; before the last step something is spoiled."""
    generator = torch.Generator().manual_seed(0)
    env.reset()
    kept = []
    for step in range(steps):
        if spoil is not None and step == steps - 1:
            spoil(env, monkeypatch)
        action = 0.3 * torch.randn(4, 12, generator=generator)
        kept.append(env.step(TensorDict({"action": action}, [4]))["next"])
    return torch.stack(kept, 1)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (spoil_simulation, "its simulation diverged"),
        (spoil_observation, "'proprio' is not finite"),
        (spoil_term, "'reward_terms/joint_torque' is not finite"),
        (spoil_reward, "'reward' is not finite"),
    ],
)
@pytest.mark.parametrize("make_task", [riding, walking])
def test_it_is_contained_named_and_dumped(make_task, spoil, reason, tmp_path, monkeypatch, caplog):
    calm = ride(QuadrupedEnv(make_task(), 4, seed=0, num_threads=1), monkeypatch)
    env = QuadrupedEnv(make_task(), 4, seed=0, dump_dir=tmp_path, num_threads=1)
    with caplog.at_level(logging.WARNING, logger="torchrl_atr"):
        wild = ride(env, monkeypatch, spoil)
    for key in wild.keys(True, True):
        assert torch.isfinite(wild[key].float()).all(), key
        assert torch.equal(wild[key][OTHERS], calm[key][OTHERS]), key
    assert wild["terminated"][:, -1, 0].tolist() == [False, False, True, False]
    # nothing of such a step can be scored but its end, and the terms still add up
    cost = {"riding": -0.2, "walking": -1.0}[env.task.name]
    assert wild["reward"][BAD, -1].item() == pytest.approx(cost)
    assert sum(term[BAD, -1].item() for term in wild["reward_terms"].values()) == pytest.approx(cost)
    assert env.num_diverged == 1
    (path,) = tmp_path.iterdir()
    assert f"env id {BAD}: {reason}" in caplog.text
    assert str(path) in caplog.text
    dump = load_dump(path)
    assert (dump["env_id"], dump["step"], dump["reason"]) == (BAD, STEP + 1, reason)
    assert dump["actions"].shape == (STEP + 1, 12)


@pytest.mark.parametrize("make_task", [riding, walking])
def test_a_replay_is_what_happened(make_task, tmp_path, monkeypatch):
    env = QuadrupedEnv(make_task(), 4, seed=0, dump_dir=tmp_path, num_threads=1)
    wild = ride(env, monkeypatch, spoil_simulation)
    (path,) = tmp_path.iterdir()
    steps = list(replay_failure(path))
    assert [step.step for step in steps] == list(range(1, STEP + 2))
    assert [step.diverged for step in steps] == [False] * STEP + [True]
    for index, step in enumerate(steps[:-1]):
        assert (step.speed, step.yaw_rate) == pytest.approx(wild["speeds"][BAD, index].tolist(), abs=1e-6)


def test_the_recorder_forgets_what_is_old(tmp_path, monkeypatch):
    env = RidingEnv(num_envs=4, seed=0, dump_dir=tmp_path)
    env._recorder.length = 3
    ride(env, monkeypatch, spoil_simulation)
    (path,) = tmp_path.iterdir()
    assert len(load_dump(path)["actions"]) == 3
    assert [step.step for step in replay_failure(path)] == [STEP - 1, STEP, STEP + 1]


def test_an_action_that_is_no_number_is_refused_by_name():
    env = RidingEnv(num_envs=4, seed=0)
    action = torch.zeros(4, 12)
    action[BAD, 3] = torch.nan
    with pytest.raises(InputError, match=rf"'action' is not finite for env ids \[{BAD}\]"):
        env.step(env.reset().set("action", action))


def test_a_dump_that_cannot_be_written_does_not_end_the_run(tmp_path, monkeypatch, caplog):
    (tmp_path / "file").write_text("in the way")
    wild = ride(RidingEnv(num_envs=4, seed=0, dump_dir=tmp_path / "file"), monkeypatch, spoil_simulation)
    assert wild["terminated"][BAD, -1].all()
    assert "it could not be written to" in caplog.text


def test_a_dump_of_another_robot_of_that_name_is_refused(tmp_path, monkeypatch):
    stiff = dataclasses.replace(ROBOTS.get("a1"), kp=50.0)
    ride(RidingEnv(stiff, num_envs=4, seed=0, dump_dir=tmp_path), monkeypatch, spoil_simulation)
    (path,) = tmp_path.iterdir()
    named = r"another 'a1' on 'single_board_g1' than the ones known here \(the robot's kp: 50 then, 40 now"
    with pytest.raises(InputError, match=named):
        list(replay_failure(path))


def test_what_is_no_dump_is_named(tmp_path):
    with pytest.raises(InputError, match="there is no dump at"):
        list(replay_failure(tmp_path / "none.pt"))
    torch.save({"weights": torch.zeros(2)}, tmp_path / "other.pt")
    with pytest.raises(InputError, match=r"other\.pt is not a dump of a diverged simulation"):
        list(replay_failure(tmp_path / "other.pt"))


def test_a_failure_of_a_task_of_ones_own_is_replayed_whatever_its_arguments(tmp_path):
    import examples.balance  # noqa: F401  # registers it; it has no pushes

    env = QuadrupedEnv(make_task("balance"), num_envs=2, num_threads=1, seed=0, dump_dir=tmp_path)
    td = env.reset()
    for spoilt in (False, True):
        env.engine.qvel[:, 0] *= float("nan") if spoilt else 1.0
        td = env.step(td.set("action", torch.zeros(2, 12)))["next"]
    *_, last = replay_failure(next(tmp_path.iterdir()))
    assert last.diverged
    assert last.step == 2

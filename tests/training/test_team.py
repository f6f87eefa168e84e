"""Processes that learn together: their averages, their runs, and their ends."""

from __future__ import annotations

import os
import time

import pytest
import torch

from torchrl_atr.training import ConfigError, Trainer, load_checkpoint, make_config
from torchrl_atr.training.team import Team, TeamError

SETTINGS = {"num_envs": 8, "rollout_steps": 4, "num_threads": 2, "epochs": 1, "minibatches": 1, "learners": 2}


def meet(team, path):
    """What two members make of their values; a helper writes it down."""
    rank = torch.tensor([team.rank, -team.rank])
    mine = {
        "a": [rank.float(), 4.0 * team.rank],
        "b": {"c": rank.double().reshape(2, 1), "count": team.rank, "d": "ours"},
    }
    found = {
        "average": team.average(mine),
        "maximum": team.maximum(rank),
        "share": team.share("ours" if team.rank == 0 else None),
        "gather": team.gather(team.rank),
    }
    torch.save(found, path / f"{team.rank}.pt")
    assert team.share(None) is None


def test_averages_and_objects_are_the_same_in_every_member(tmp_path):
    team = Team.form(2, meet, tmp_path)
    try:
        meet(team, tmp_path)
    finally:
        team.disband()
    leader, helper = (torch.load(tmp_path / f"{rank}.pt") for rank in (0, 1))
    assert leader.pop("gather") == [0, 1]
    assert helper.pop("gather") == []
    for rank, found in enumerate((leader, helper)):
        (first, number), rest = found["average"]["a"], found["average"]["b"]
        assert first.tolist() == [0.5, -0.5]
        assert first.dtype == torch.float32
        assert number == 2.0
        assert rest["c"].tolist() == [[0.5], [-0.5]]
        assert rest["c"].dtype == torch.float64
        assert (rest["count"], rest["d"]) == (rank, "ours")  # what is no real number is one's own
        assert found["maximum"].tolist() == [1, 0]
        assert found["share"] == "ours"


class Stillborn:
    """A helper that does not survive the way into its process."""

    def __call__(self, team):
        raise AssertionError

    def __setstate__(self, state):
        os._exit(1)

    def __getstate__(self):
        return {"some": "state"}


def test_a_helper_that_cannot_be_started_is_not_waited_for():
    with pytest.raises(TeamError, match="learners=2: a learner could not be started"):
        Team.form(2, Stillborn())
    assert not torch.distributed.is_initialized()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of four iterations by two learners, and the same one interrupted after two and resumed."""
    folder = tmp_path_factory.mktemp("runs")
    config = make_config({**SETTINGS, "total_frames": 4 * 32, "minibatches": 2})
    straight = Trainer(config, folder / "straight")
    straight.train()
    halves = Trainer(config, folder / "halves")
    halves.train(lambda metrics: metrics["iteration"] == 2)
    resumed = Trainer(config, folder / "halves", load_checkpoint(folder / "halves"))
    resumed.train()
    return folder, straight, resumed


def test_a_run_of_two_learners_counts_all_frames_and_resumes_bit_for_bit(run):
    folder, straight, resumed = run
    assert (straight.frames, straight.iteration) == (128, 4)
    assert straight.env.batch_size == (4,)
    states = [load_checkpoint(folder / name) for name in ("straight", "halves")]
    robots = [state["collection"]["env"]["qpos"] for state in states]
    others = [state["members"][0]["collection"]["env"]["qpos"] for state in states]
    assert not torch.equal(robots[0], others[0])  # each has its own
    assert torch.equal(robots[0], robots[1])
    assert torch.equal(others[0], others[1])
    for name, value in straight.learner.networks.state_dict().items():
        assert torch.equal(value, resumed.learner.networks.state_dict()[name]), name


def test_a_killed_learner_is_a_named_error_and_the_last_checkpoint_stands(run, tmp_path):
    config = make_config({**SETTINGS, "total_frames": 10_000})
    trainer = Trainer(config, tmp_path / "run")
    pids = []

    def kill(metrics):
        pids.append(trainer.member.team._helpers[0].pid)
        os.kill(pids[0], 9)

    started = time.monotonic()
    with pytest.raises(TeamError, match=r"learners=2: a learner failed .* --resume"):
        trainer.train(kill)
    assert time.monotonic() - started < 100
    assert load_checkpoint(tmp_path / "run")["iteration"] == 0
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)
    assert not torch.distributed.is_initialized()


def test_what_cannot_be_shared_is_refused():
    with pytest.raises(ConfigError, match="num_envs=7 cannot be shared evenly by learners=2"):
        make_config({"num_envs": 7, "learners": 2})
    with pytest.raises(ConfigError, match="learners=2 are for collector='direct' and device='cpu'"):
        make_config({"collector": "process", "learners": 2})


def test_shares_are_of_robots_cpus_and_seeds():
    config = make_config({"num_envs": 12, "num_threads": 7, "seed": 3, "learners": 3})
    shares = [config.share(rank) for rank in range(3)]
    assert {(share.num_envs, share.num_threads, share.learners) for share in shares} == {(4, 2, 1)}
    assert len({share.seed for share in shares}) == 3
    assert shares[0].seed == 3
    alone = make_config({"learners": 1})
    assert alone.share(0) is alone

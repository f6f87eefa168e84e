"""Processes that learn together: their averages, their runs, and their ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from tests.training.states import FRAMES, SMALL, differing
from torchrl_atr.training import ConfigError, Trainer, load_checkpoint, make_config
from torchrl_atr.training.team import Team, TeamError

SETTINGS = {
    **SMALL,
    "compute.num_threads": 2,
    "compute.learners": 2,
    "task.moving_start": 0.0,
    "curriculum.tracking_threshold": 0.01,
}


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


def test_a_run_of_two_learners_shares_what_it_learned_and_resumes_bit_for_bit(tmp_path):
    config = make_config(SETTINGS)
    straight = Trainer(config, tmp_path / "straight")
    straight.train()
    assert (straight.frames, straight.iteration) == (FRAMES, 6)
    assert straight.env.batch_size == (4,)
    halves = Trainer(config, tmp_path / "halves")
    halves.train(lambda metrics: metrics["iteration"] == 3)
    Trainer(config, tmp_path / "halves", load_checkpoint(tmp_path / "halves")).train()

    ends = [load_checkpoint(tmp_path / name) for name in ("straight", "halves")]
    for end in ends:
        for saving in ("seconds", "provenance", "best_reward"):  # depend on the clock, and on when it was saved
            del end[saving]
    assert differing(*ends) == []
    ours, theirs = ends[0]["collection"], ends[0]["members"][0]["collection"]
    assert not torch.equal(ours["env"]["qpos"], theirs["env"]["qpos"])  # each has its own robots
    weights = ends[0]["curriculum"]["weights"]
    assert weights.sum() > straight.curriculum.grid.initial_weights().sum()
    assert torch.equal(theirs["transforms"]["transforms.0.weights"], weights)


def test_a_killed_learner_is_a_named_error_and_the_last_checkpoint_stands(tmp_path):
    trainer = Trainer(make_config({**SETTINGS, "total_frames": 10_000}), tmp_path / "run")
    pids = []

    def kill(metrics):
        pids.append(trainer.member.team._helpers[0].pid)
        os.kill(pids[0], signal.SIGKILL)

    started = time.monotonic()
    with pytest.raises(TeamError, match=r"learners=2: a learner failed .* --resume"):
        trainer.train(kill)
    assert time.monotonic() - started < 100
    assert load_checkpoint(tmp_path / "run")["iteration"] == 0
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)
    assert not torch.distributed.is_initialized()


def test_a_checkpoint_of_one_learner_is_not_gone_on_with_by_two(tmp_path):
    config = make_config({**SETTINGS, "compute.learners": 1, "total_frames": 64})
    Trainer(config, tmp_path).train()
    with pytest.raises(ConfigError, match="learners=2: the checkpoint is of 1; go on with as many"):
        Trainer(make_config(SETTINGS), tmp_path, load_checkpoint(tmp_path))


FORGETFUL = """
from torchrl_atr.training.team import Team
from tests.training.test_team import wait_for_orders

if __name__ == "__main__":
    team = Team.form(2, wait_for_orders)
    print(team._helpers[0].pid, flush=True)
"""


def wait_for_orders(team):
    """What helpers do between iterations."""
    team.share(None)


def test_a_leader_that_ends_without_a_word_leaves_no_helpers(tmp_path):
    program = tmp_path / "forgetful.py"
    program.write_text(FORGETFUL)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, str(program)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True)
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)


def test_what_cannot_be_shared_is_refused():
    with pytest.raises(ConfigError, match="num_envs=7 cannot be shared evenly by learners=2"):
        make_config({"env.num_envs": 7, "compute.learners": 2})
    with pytest.raises(ConfigError, match="learners=2 are for collector 'direct' and device 'cpu'"):
        make_config({"compute.collector": "process", "compute.learners": 2})


def test_shares_are_of_robots_cpus_and_seeds():
    config = make_config({"env.num_envs": 12, "compute.num_threads": 7, "seed": 3, "compute.learners": 3})
    shares = [config.share(rank) for rank in range(3)]
    assert {(share.env.num_envs, share.compute.num_threads, share.compute.learners) for share in shares} == {(4, 2, 1)}
    assert len({share.seed for share in shares}) == 3
    assert shares[0].seed == 3
    alone = make_config({"compute.learners": 1})
    assert alone.share(0) is alone

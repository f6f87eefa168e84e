"""The comparison of every pair, on a few robots and steps, and what is written about it."""

from __future__ import annotations

import json
from functools import partial

import pytest
import torch
from tensordict.nn import TensorDictModule

from benchmarks import every_pair
from torchrl_atr.envs import make_riding_env
from torchrl_atr.training import DEPLOYMENT_OVERRIDES

make_env = partial(make_riding_env, "a1", "single_board", num_threads=1, **DEPLOYMENT_OVERRIDES)
BOX = (1.0, 0.3)
RUN = {"frames": 128, "minutes": 10.0, "hardware": {"cpus": 2, "processor": "Some CPU"}}


def jump(observation):
    """All legs stretched as far as they go: it falls."""
    return torch.full((len(observation), 12), 20.0)


def test_the_zero_action_compared_with_itself_is_a_tie():
    """Same robots, same initial states, same commands: or one of the two would be luckier."""
    figures = every_pair.compare(every_pair.zero_action(12), make_env, BOX, robots=8, seconds=0.4, seed=1)
    assert figures["deployed"] == figures["zero_action"]
    assert figures["zero_action"]["survival"] == 1.0


def test_a_return_ends_with_the_fall():
    policy = TensorDictModule(jump, ["observation"], ["action"])
    rides = [
        every_pair.first_episodes(policy, make_env(num_envs=4, seed=0), torch.zeros(4, 2), steps) for steps in (75, 90)
    ]
    assert rides[0] == rides[1]
    assert rides[0]["survival"] == 0.0


def write_pair(output, pair, returns):
    folder = output / pair.replace(":", "-")
    folder.mkdir(parents=True)
    rows = "".join(f"{i},{i / 10},{20 + i},{i}\n" for i in range(1, 30))
    (folder / "progress.csv").write_text("iteration,minutes,episode_length,episode_reward\n0,0,,\n" + rows)
    record = {
        "command": f"python -m benchmarks.every_pair --minutes 10 --seed 0 --pairs {pair}",
        "run": RUN,
        "comparison": {"robots": 8, "seconds": 10.0, "seed": 1, "command_box": BOX},
        "deployed": {"mean_return": returns, "survival": 0.75},
        "zero_action": {"mean_return": 3.0, "survival": 0.5},
    }
    (folder / every_pair.COMPARISON).write_text(json.dumps(record))


def test_a_table_and_a_figure_of_the_pairs_that_are_there(tmp_path):
    write_pair(tmp_path, "a1:single_board", 4.0)
    write_pair(tmp_path, "go1:two_board", 2.0)
    every_pair.summarise(tmp_path)
    text = (tmp_path / "README.md").read_text()
    assert "`python -m benchmarks.every_pair --minutes 10 --seed 0` on 2 cores (Some CPU)." in text
    assert "1 of 2 policies beat the zero action on both figures" in text
    assert "| go1 | two_board | 10.0 | 128 | 2.00 | 3.00 | 75.0% | 50.0% |" in text
    assert (tmp_path / "learning_curves.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("survival", "still", "beats"), [(0.9, 0.8, True), (0.9, 0.9, False), (1.0, 1.0, True), (0.9, 1.0, False)]
)
def test_a_tie_counts_only_where_nobody_falls(survival, still, beats):
    ours, zero = {"mean_return": 2.0, "survival": survival}, {"mean_return": 1.0, "survival": still}
    assert every_pair._beats({"deployed": ours, "zero_action": zero}) is beats
    assert not every_pair._beats({"deployed": zero, "zero_action": ours})


def test_it_trains_compares_and_does_not_train_again(tmp_path, monkeypatch):
    tiny = {
        "env.num_envs": 4,
        "ppo.rollout_steps": 4,
        "ppo.minibatches": 1,
        "compute.num_threads": 1,
        "total_frames": 32,
    }
    make_config = every_pair.make_config
    monkeypatch.setattr(every_pair, "make_config", lambda values: make_config({**tiny, **values}))
    monkeypatch.setattr(every_pair, "ROBOTS_COMPARED", 2)
    monkeypatch.setattr(every_pair, "SECONDS", 0.1)
    arguments = ["--output", str(tmp_path), "--pairs", "spot:two_board", "--minutes", "5"]
    assert every_pair.main(arguments) == 0
    record = json.loads((tmp_path / "spot-two_board" / "comparison.json").read_text())
    assert record["run"]["frames"] == 32
    assert set(record["policy_reads"]) == {"history", "observation", "dead_reckoned_velocity"}
    monkeypatch.setattr(every_pair, "train", lambda *_: pytest.fail("it trained again"))
    assert every_pair.main(arguments) == 0


def test_runs_of_other_settings_are_refused(tmp_path, capsys):
    folder = tmp_path / "a1-single_board"
    folder.mkdir()
    (folder / "config.toml").write_text("max_minutes = 3.0\n")
    assert every_pair.main(["--output", str(tmp_path), "--pairs", "a1:single_board"]) == 2
    assert "trained with max_minutes=3.0 instead of 10.0; give another folder" in capsys.readouterr().err

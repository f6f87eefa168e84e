"""A published run is small, rides as the run does, and can be begun from."""

from __future__ import annotations

import json

import pytest
import torch

from benchmarks import scorecard, zoo
from scripts import publish_run
from torchrl_atr.training import Trainer, load_checkpoint, load_run, make_config

TINY = {"env.num_envs": 8, "ppo.rollout_steps": 8, "total_frames": 3 * 64, "compute.num_threads": 1}


def test_a_published_run_holds_the_deployed_weights_alone(tmp_path):
    config = make_config({**TINY, "seed": 3})
    Trainer(config, tmp_path / "run").train()
    assert publish_run.main([str(tmp_path / "run"), str(tmp_path / "published")]) == 0
    files = {path.name for path in (tmp_path / "published").iterdir()}
    assert files == {"checkpoint.pt", "config.toml", "run.json", "progress.csv"}
    sizes = [(tmp_path / name / "checkpoint.pt").stat().st_size for name in ("run", "published")]
    assert sizes[1] < 0.5 * sizes[0]
    ours, theirs = (load_run(tmp_path / name, num_envs=1)[2].state_dict() for name in ("run", "published"))
    assert all(torch.equal(value, theirs[name]) for name, value in ours.items())
    begun = Trainer(make_config({**TINY, "seed": 4}), tmp_path / "begun", begin_from=tmp_path / "published")
    assert begun.train() is None
    assert load_checkpoint(tmp_path / "begun")["frames"] == 192


@pytest.mark.usefixtures("undrawn")
def test_its_evaluations_go_with_it_and_make_its_scorecard(tmp_path):
    run, published = tmp_path / "run", tmp_path / "published"
    Trainer(make_config({**TINY, "total_frames": 64}), run).train()
    scorecard.measure(run, 5, ["endurance"], zoo.QUICK_ROWS)
    assert publish_run.main([str(run), str(published)]) == 0
    assert {file.name for file in (published / "endurance").iterdir()} == {"metrics.json", "endurance.png"}
    card = json.loads((published / "scorecard.json").read_text())
    assert card["command"] == f"python -m benchmarks.scorecard {published} --seed 5 --rows endurance"
    assert card["evaluations"].keys() == {"endurance"}


def test_a_folder_without_a_run_is_named(tmp_path, capsys):
    assert publish_run.main([str(tmp_path), str(tmp_path / "out")]) == 2
    assert str(tmp_path) in capsys.readouterr().err

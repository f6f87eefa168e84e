"""Figure 7: the ablations change what they say, and a run that was stopped goes on."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from torchrl_atr._interrupt import Stopped
from torchrl_atr._registry import UnknownNameError
from torchrl_atr.reproduction import figure7 as module
from torchrl_atr.reproduction.figure7 import VARIANTS, Sizes, figure7
from torchrl_atr.reproduction.tracking import Grid
from torchrl_atr.training import Trainer

from .conftest import TINY

GRID = Grid(speed_step=15.0, yaw_rate_step=2.0, robots=1, seconds=0.04, settle=0.02)


@pytest.mark.parametrize("name", VARIANTS)
def test_every_ablation_is_a_valid_recipe_that_differs_where_it_says(name):
    full, config = (module._config(each, 3, Sizes(), 1000, {}, ()) for each in ("full", name))
    assert (config.seed, config.total_frames) == (3, 1000)
    assert (config == full) == (name == "full")
    if name == "no curriculum":
        assert config.grid.initial == config.grid.bounds
    if name in ("no intrinsic", "no extrinsic"):
        assert set(full.roa.actor_reads) - set(config.roa.actor_reads) == {
            {"no intrinsic": "latent"}.get(name, "extrinsic")
        }


def test_runs_are_trained_once_stopped_ones_go_on_and_all_are_measured(job, tmp_path, monkeypatch):
    trained, train = [], Trainer.train

    def stop_the_second(self):
        trained.append(self.run.parent.name)
        return 15 if len(trained) == 2 else train(self)

    monkeypatch.setattr(Trainer, "train", stop_the_second)
    chosen = {"variants": ["no extrinsic", "full"], "seeds": 1, "frames": 4, "settings": TINY, "grid": GRID}
    job = replace(job, policies=[])
    with pytest.raises(Stopped):
        figure7(job, tmp_path, **chosen)
    figure7(job, tmp_path, **chosen)
    page = figure7(job, tmp_path, **chosen).read_text()
    assert [name.rpartition("-")[0] for name in trained] == ["train-full-0", *["train-no_extrinsic-0"] * 2]
    assert "| no extrinsic | " in page
    values = json.loads((tmp_path / "figure7.json").read_text())
    assert values["frames"] == 4
    assert values["variants"]["no extrinsic"]["settings"]["roa.actor_reads"] == ["latent"]
    assert values["claims"][0]["verdict"] == "cannot be told"  # of one seed


def test_an_unknown_variant_is_refused(job, tmp_path):
    with pytest.raises(UnknownNameError, match="unknown variant 'no_symmetry'; did you mean 'no symmetry'"):
        figure7(job, tmp_path, variants=["no_symmetry"])

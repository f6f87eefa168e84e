"""Figure 7: the ablations change what they say, and a run that was stopped goes on."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from torchrl_atr._errors import InputError
from torchrl_atr._interrupt import Stopped
from torchrl_atr._registry import UnknownNameError
from torchrl_atr.evaluation import TrackingResult
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


def test_a_training_that_was_stopped_goes_on_and_is_measured(job, tmp_path, monkeypatch):
    trained, train = [], Trainer.train

    def stop_the_first(self):
        trained.append(self.run)
        self.save()
        return 15 if len(trained) == 1 else train(self)

    monkeypatch.setattr(Trainer, "train", stop_the_first)
    chosen = {"variants": ["no extrinsic"], "seeds": 1, "frames": 4, "settings": TINY, "grid": GRID}
    job = replace(job, policies=[])
    with pytest.raises(Stopped):
        figure7(job, tmp_path, **chosen)
    page = figure7(job, tmp_path, **chosen).read_text()
    assert len(trained) == 2
    assert trained[0] == trained[1]
    assert job.parts.holds(trained[0].parent)
    assert "| no extrinsic | " in page
    values = json.loads((tmp_path / "figure7.json").read_text())
    assert values["frames"] == 4
    assert values["variants"]["no extrinsic"]["settings"]["roa.actor_reads"] == ["latent"]


def test_claims_compare_with_the_full_method_over_seeds():
    def covering(share):
        fall = np.full((1, 1, 10), np.nan)
        fall[..., round(10 * share) :] = 1.0
        zero, axis = np.zeros_like(fall), np.zeros(1)
        return TrackingResult(axis, axis, *[zero] * 6, fall, 10.0, 5.0)

    results = {
        "full": [0.8, 0.9, 0.9],
        "no symmetry": [0.4, 0.5, 0.4],
        "no curriculum": [0.9, 0.8, 0.9],
        "no ROA": [0.5],
    }
    claims = module._claims({name: [covering(share) for share in shares] for name, shares in results.items()})
    assert [claim.verdict for claim in claims] == ["holds", "cannot be told", "cannot be told"]
    assert claims[0].value == pytest.approx(13 / 30)


def test_settings_that_leave_nothing_to_compare_or_another_robot_are_refused(job, tmp_path):
    with pytest.raises(InputError, match="no symmetry: these settings are those of 'full' already"):
        figure7(job, tmp_path, variants=["no symmetry"], settings={"preset": "paper"})
    for name, value in {"task.robot": "go1", "task.transporter": "two_board", "seed": 5}.items():
        with pytest.raises(InputError, match=rf"{name}=.*leave it out"):
            figure7(job, tmp_path, settings={name: value})


def test_an_unknown_variant_is_refused(job, tmp_path):
    with pytest.raises(UnknownNameError, match="unknown variant 'no_symmetry'; did you mean 'no symmetry'"):
        figure7(job, tmp_path, variants=["no_symmetry"])

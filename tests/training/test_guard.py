"""Optimiser steps without numbers are left out; a run that takes no others ends at its last checkpoint."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.training import Trainer, TrainingDiverged, load_checkpoint, make_config
from torchrl_atr.training.guard import PATIENCE

TINY = {
    "env.num_envs": 8,
    "ppo.rollout_steps": 8,
    "total_frames": 4 * 64,
    "compute.num_threads": 1,
    "ppo.minibatches": 2,
    "ppo.epochs": 1,
}


def spoil_gradient(trainer, times):
    """The gradient of the critic's first weight is NaN for its next ``times`` backward passes."""
    left = [times]

    def hook(gradient):
        left[0] -= 1
        return gradient * torch.nan if left[0] >= 0 else gradient

    next(trainer.learner.networks.critic.parameters()).register_hook(hook)


def test_one_bad_gradient_is_left_out_and_counted(tmp_path):
    trainer, seen = Trainer(make_config(TINY), tmp_path / "run"), []
    spoil_gradient(trainer, 3)
    trainer.train(seen.append)
    assert seen[-1]["skipped_steps"] == 3
    for parameter in trainer.learner.networks.parameters():
        assert torch.isfinite(parameter).all()


def test_many_in_a_row_end_the_run_at_its_last_good_checkpoint(tmp_path):
    config = make_config({**TINY, "total_frames": 100 * 64, "logging.checkpoint_seconds": 0.0})
    trainer = Trainer(config, tmp_path / "run")
    good = {}

    def spoil(metrics):
        if metrics["iteration"] == 2:
            good.update({name: p.clone() for name, p in trainer.learner.networks.critic.named_parameters()})
            spoil_gradient(trainer, 10**6)

    with pytest.raises(TrainingDiverged, match=rf"{PATIENCE + 1} optimiser steps .* \(the gradient of the critic\)"):
        trainer.train(spoil)
    saved = load_checkpoint(tmp_path / "run")["learner"]["networks"]
    for name, value in good.items():
        assert torch.equal(saved[f"critic.{name}"], value)


def test_a_policy_that_went_too_far_waits_for_the_next_batch(tmp_path):
    config = make_config(
        {**TINY, "ppo.epochs": 8, "ppo.learning_rate": 0.5, "ppo.max_learning_rate": 0.5, "total_frames": 64}
    )
    trainer = Trainer(config, tmp_path / "run")
    trainer.train()
    policy, estimators = (trainer.learner.optimizers[name] for name in ("policy", "estimators"))
    assert {int(state["step"]) for state in estimators.state.values()} == {2 * config.estimator.epochs}
    taken = {int(state["step"]) for state in policy.state.values()}
    assert len(taken) == 1
    assert 1 <= taken.pop() < 16

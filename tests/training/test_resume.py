"""A run that stopped goes on as if it had not."""

from __future__ import annotations

import signal

import pytest
import torch

from tests.training.states import FRAMES, SMALL, differing
from torchrl_atr.training import CheckpointError, Trainer, load_checkpoint, make_config


def interrupt_after(iteration):
    """What a scheduler does to a run."""

    def check(metrics):
        if metrics["iteration"] == iteration:
            signal.raise_signal(signal.SIGTERM)

    return check


@pytest.mark.parametrize(
    ("task", "act_source", "other"),
    [
        *(("riding", act_source, other) for act_source in ("mixed", "privileged") for other in (None, "other")),
        ("walking", "mixed", None),
    ],
)
def test_resumed_equals_uninterrupted_bit_for_bit(tmp_path, task, act_source, other):
    small = {**SMALL, "task.name": task, "roa.act_source": act_source}
    config = make_config(small)
    start = other and tmp_path / other
    if start is not None:
        Trainer(make_config({**small, "total_frames": 64, "seed": 1}), start).train()
    straight = Trainer(config, tmp_path / "straight", begin_from=start)
    straight.train()

    first = Trainer(config, tmp_path / "resumed", begin_from=start)
    assert first.train(interrupt_after(3)) == signal.SIGTERM
    state = load_checkpoint(tmp_path / "resumed")
    assert state["frames"] == FRAMES // 2
    resumed = Trainer(config, tmp_path / "resumed", state)
    resumed.train()

    ends = [load_checkpoint(tmp_path / name) for name in ("straight", "resumed")]
    for end in ends:
        for saving in ("seconds", "provenance", "best_reward"):  # depend on the clock, and on when it was saved
            del end[saving]
    assert differing(*ends) == []
    uniforms = [trainer.curriculum._generator.get_state() for trainer in (straight, resumed)]
    assert torch.equal(*uniforms)  # the next commands are the same
    assert differing(state["learner"]["networks"], ends[1]["learner"]["networks"])  # it did go on


def test_episodes_of_other_transforms_are_refused_and_the_checkpoint_is_kept(tmp_path):
    config = make_config(SMALL)
    assert Trainer(config, tmp_path).train(interrupt_after(1)) == signal.SIGTERM
    state, before = load_checkpoint(tmp_path), (tmp_path / "checkpoint.pt").read_bytes()
    state["collection"]["transforms"].popitem()
    with pytest.raises(CheckpointError, match=r"do not fit this code .* begin a new run with --from"):
        Trainer(config, tmp_path, state).train()
    assert (tmp_path / "checkpoint.pt").read_bytes() == before

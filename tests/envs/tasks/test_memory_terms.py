"""Memory terms as data: carried from step to step for each robot, started anew with its episode."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr._compilation import compiler
from torchrl_atr.envs import QuadrupedEnv, RewardTerm
from torchrl_atr.envs.tasks import MemoryTerm, MemoryTermError, ObservationTerm, riding, walking

COUNT = MemoryTerm(1, lambda c: c.memory["count"] + 1.0)
EAGER_AND_COMPILED = [False, pytest.param(True, marks=pytest.mark.skipif(compiler() is None, reason="no compiler"))]


def make(memory: object = COUNT, **arguments: object) -> QuadrupedEnv:
    task = riding(pushes=False)
    task = task.replace(
        memory={**task.memory, "count": memory},
        rewards={**task.rewards, "patience": RewardTerm(lambda c: c.memory["count"][:, 0], 1.0)},
    ).with_observation("count", count=ObservationTerm(lambda c: c.memory["count"]))
    return QuadrupedEnv(task, 3, **{"seed": 0, "num_threads": 1, **arguments})


def step(env: QuadrupedEnv) -> TensorDict:
    return env.step(TensorDict({"action": torch.zeros(3, 12)}, [3]))["next"]


@pytest.mark.usefixtures("traced")
@pytest.mark.parametrize("compiled", EAGER_AND_COMPILED)
def test_a_counter_counts_is_scored_and_starts_anew_for_the_rows_that_do(compiled):
    env = make(compiled=compiled)
    assert env.reset()["count"].tolist() == [[0.0]] * 3
    for count in (1.0, 2.0):
        td = step(env)
        assert td["count"].tolist() == [[count]] * 3
        torch.testing.assert_close(td["reward_terms", "patience"], 0.02 * td["count"])
    reset = env.reset(td.exclude("reward").set("_reset", torch.tensor([[False], [True], [False]])))
    assert reset["count"].flatten().tolist() == [2.0, 0.0, 2.0]
    assert step(env)["count"].flatten().tolist() == [3.0, 1.0, 3.0]


def test_what_was_handed_out_before_does_not_change():
    env = make()
    env.reset()
    first = step(env)["count"]
    step(env)
    env.reset()
    assert first.tolist() == [[1.0]] * 3


def test_it_is_part_of_the_state():
    env = make()
    env.reset()
    step(env)
    state = env.get_state()
    step(env)
    env.set_state(state)
    assert step(env)["count"].tolist() == [[2.0]] * 3
    with pytest.raises(KeyError, match="the state lacks 'count'"):
        env.set_state(state.exclude("count"))


def test_a_start_of_its_own_sees_the_state_that_an_episode_begins_with():
    height = MemoryTerm(1, lambda c: c.memory["count"], start=lambda c: c.state.position[:, 2:])
    env = make(height)
    started = env.reset()["count"]
    torch.testing.assert_close(started[:, 0], env.engine.qpos[:, env.scene.layout.root_qpos + 2].float())
    assert started.unique().numel() == 3
    assert torch.equal(step(env)["count"], started)


@pytest.mark.parametrize(
    ("memory", "message"),
    [
        (lambda c: c.action, "the memory term 'count' is <function"),
        (
            MemoryTerm(2, lambda c: c.action),
            r"'count' returned \(3, 12\) of float32; it must .* shape \(3, 2\)",
        ),
        (MemoryTerm(12, lambda c: c.action.double()), r"'count' returned \(3, 12\) of float64; it must return float32"),
        (MemoryTerm(1, lambda c: 1.0), "'count' returned float"),
        (MemoryTerm(1, lambda c: c.memory["count"], start=lambda c: c.action), r"'count' returned \(3, 12\)"),
        (MemoryTerm(1, lambda c: c.state.nose), "'count' failed: AttributeError: .*nose"),
        (MemoryTerm(1, lambda c: c.memory["count"], start=lambda c: c.state.nose), "'count' failed: AttributeError"),
    ],
)
def test_a_term_that_cannot_be_used_is_named_before_the_first_step(memory, message):
    with pytest.raises(MemoryTermError, match=message):
        make(memory)


@pytest.mark.parametrize("name", ["qpos", "steps", "foot_places", "emitted"])
def test_a_name_that_the_state_has_already_is_refused(name):
    """It would be saved and restored in the other's place."""
    task = walking()
    with pytest.raises(MemoryTermError, match=f"the memory term '{name}' has the name of a state entry; give it anoth"):
        QuadrupedEnv(task.replace(memory={**task.memory, name: MemoryTerm(1, lambda c: c.command[:, :1])}), 1)

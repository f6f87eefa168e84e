"""Overspeed termination: the bound follows the curriculum's frontier, and only what exceeds it ends."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from torchrl_atr.envs import RidingEnv, make_riding_env
from torchrl_atr.envs.transforms import CommandCurriculum, OverspeedTermination


def beyond(transform: OverspeedTermination, speeds: list[list[float]]) -> list[bool]:
    after = TensorDict({"speeds": torch.tensor(speeds)}, [len(speeds)])
    return transform.too_fast(after).squeeze(-1).tolist()


def test_only_rows_beyond_the_frontier_and_the_margin_end():
    curriculum = CommandCurriculum((0.16, 0.16), seed=0)  # frontier 0.5 m/s, 0.3 rad/s
    transform = OverspeedTermination(curriculum, (2.0, 1.0))
    speeds = [[2.4, 0.0], [2.6, 0.0], [-2.6, 0.0], [0.0, 1.2], [0.0, -1.4], [0.0, 0.0]]
    assert beyond(transform, speeds) == [False, True, True, False, True, False]
    curriculum.load_weights(torch.ones_like(curriculum.weights))  # frontier 15 m/s, 2 rad/s
    assert not any(beyond(transform, speeds))


def test_in_the_stack_overspeed_ends_its_own_episode():
    env = make_riding_env(num_envs=3, num_threads=1, seed=0, overspeed_margin=(2.0, 2.0))
    td = env.reset()
    env.base_env.engine.hook.speeds[1, 0] = 4.0  # of the second of three
    td["action"] = torch.zeros(env.action_spec.shape)
    after, carried = env.step_and_maybe_reset(td)
    assert torch.equal(after["next", "done"], after["next", "terminated"])
    assert after["next", "terminated"].squeeze(-1).tolist() == [False, True, False]
    terms = after["next", "reward_terms"]
    assert terms["termination"].squeeze(-1).tolist() == pytest.approx([0.0, -0.2, 0.0])  # r17 times dt
    total = torch.stack(list(terms.values())).sum(0)
    assert torch.allclose(total, after["next", "reward"], atol=1e-6)
    assert float(after["next", "speeds"][1, 0]) > 3.5  # the true terminal observation
    assert carried["speeds"][1].abs().max() < 1e-6


def test_a_fall_that_is_too_fast_as_well_is_penalised_once():
    env = make_riding_env(num_envs=2, num_threads=1, seed=0, overspeed_margin=(2.0, 2.0))
    td, engine = env.reset(), env.base_env.engine
    engine.hook.speeds[:, 0] = 4.0
    root = engine.scene.layout.root_qpos
    engine.qpos[1, root + 3 : root + 7] = torch.tensor([0.0, 1.0, 0.0, 0.0], dtype=torch.float64)  # on its back
    after = env.step(td.set("action", torch.zeros(env.action_spec.shape)))["next"]
    assert after["terminated"].all()
    terms = after["reward_terms"]
    assert terms["termination"].squeeze(-1).tolist() == pytest.approx([-0.2, -0.2])
    torch.testing.assert_close(torch.stack(list(terms.values())).sum(0), after["reward"])


def test_a_copy_of_a_stack_watches_the_curriculum_of_the_copy():
    env = make_riding_env(num_envs=2, num_threads=1, seed=0, overspeed_margin=(2.0, 2.0))
    copy = TransformedEnv(RidingEnv(num_envs=2, num_threads=1, seed=0), env.transform.clone())
    curriculum = copy.transform[0]
    curriculum.load_weights(torch.ones_like(curriculum.weights))  # frontier 15 m/s; of the original 0.5
    ended = []
    for each in (env, copy):
        td = each.reset()
        each.base_env.engine.hook.speeds[:, 0] = 6.0
        ended.append(bool(each.step(td.set("action", torch.zeros(2, 12)))["next", "terminated"].all()))
    assert ended == [True, False]


def test_bad_margin():
    with pytest.raises(ValueError, match="margin must be two positive numbers"):
        OverspeedTermination(CommandCurriculum((0.16, 0.16), seed=0), (0.0, 1.0))

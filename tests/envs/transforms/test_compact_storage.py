from __future__ import annotations

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import SerialEnv
from torchrl.envs.utils import check_env_specs

from torchrl_atr.envs import make_riding_env
from torchrl_atr.envs.tasks import RIDING_REWARDS
from torchrl_atr.envs.transforms import CompactStorage


def collect(compact_storage, steps=30):
    """Batches of robots whose episodes end at different times."""
    env = make_riding_env(num_envs=6, num_threads=1, seed=0, max_steps=12, stagger=1, compact_storage=compact_storage)
    lean = torch.linspace(-1.0, 1.0, 6)[:, None].expand(6, 12)
    collector = Collector(env, lambda state: state.set("action", lean), frames_per_batch=6 * steps, trust_policy=True)
    batch = next(iter(collector))
    collector.shutdown()
    return batch


def test_what_is_stored_is_what_was_stored_but_once():
    once, twice = collect(True), collect(False)
    dropped = {("next", "history"), *(("reward_terms", name) for name in RIDING_REWARDS)}
    kept = set(once.keys(True, True))
    assert {key for key in twice.keys(True, True) if isinstance(key, tuple) or key != "reward_terms"} - kept == dropped
    assert len(twice["next", "done"].any(0).nonzero()) > 5
    for key in kept:
        assert torch.equal(once[key], twice[key]), key


def test_specs_tell_that_what_is_in_next_alone_is_not_observed():
    env = make_riding_env(num_envs=2, num_threads=1, seed=0)
    env.append_transform(CompactStorage(in_next=["reward_terms"]))
    check_env_specs(env)
    assert "reward_terms" not in env.observation_spec
    assert "reward_terms" not in env.reset()
    assert set(env.fake_tensordict()["next", "reward_terms"].keys()) == set(RIDING_REWARDS)


def test_steps_alone_hold_all_and_what_collectors_store_does_not():
    env = make_riding_env(num_envs=2, num_threads=1, seed=0, compact_storage=True)
    root = env.rand_action(env.reset())
    assert "history" in env.step(root.clone())["next"]  # as TorchRL's step_mdp needs it
    stored, following = env.step_and_maybe_reset(root)
    assert "history" not in stored["next"]
    assert following["history"].shape == (2, 10, 46)
    assert set(stored.keys(True, True)) == set(env.fake_tensordict().keys(True, True))


def test_a_root_from_elsewhere_hands_nothing_on():
    plain = make_riding_env(num_envs=2, num_threads=1, seed=0)
    root = plain.rand_step(plain.reset())["next"]
    assert "reward_terms" in root
    env = make_riding_env(num_envs=2, num_threads=1, seed=0, compact_storage=True)
    env.reset()
    _, following = env.step_and_maybe_reset(env.rand_action(root.exclude("reward")))
    assert "reward_terms" not in following


def test_all_but_the_last_step_of_a_rollout_that_does_not_stop():
    env = make_riding_env(num_envs=2, num_threads=1, seed=0, compact_storage=True)
    steps = env.rollout(4, break_when_any_done=False)["next"].unbind(-1)
    assert ["history" in step for step in steps] == [False, False, False, True]


@pytest.mark.parametrize("where", ["at_root", "in_next"])
@pytest.mark.parametrize(
    ("wrong", "meant"), [("histroy", "history"), (("reward_terms", "terminaton"), "('reward_terms', 'termination')")]
)
def test_an_unknown_entry_is_named(where, wrong, meant):
    env = make_riding_env(num_envs=1, num_threads=1, seed=0).append_transform(CompactStorage(**{where: [wrong]}))
    with pytest.raises(KeyError) as error:
        _ = env.observation_spec
    assert str(wrong) in error.value.args[0]
    assert meant in error.value.args[0]


def test_workers_of_a_batched_env_refuse_it():
    def worker():
        return make_riding_env(num_envs=1, num_threads=1, seed=0, compact_storage=True)

    with pytest.raises(RuntimeError, match=r"CompactStorage.*wrap it"):
        SerialEnv(2, worker).reset()


def test_it_cannot_be_applied_to_data():
    with pytest.raises(NotImplementedError, match="environment"):
        CompactStorage().forward(make_riding_env(num_envs=1, num_threads=1, seed=0).reset())

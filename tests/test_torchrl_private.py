"""TorchRL still has the private names that the package relies on, and calls them where it did."""

from __future__ import annotations

import subprocess
from functools import partial
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import Compose, ParallelEnv, SerialEnv, StepCounter, TransformedEnv
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.testing.mocking_classes import CountingEnv

from torchrl_atr._torchrl_private import (
    AfterStepTransform,
    ExtensibleClipPPOLoss,
    carried_root,
    env_around,
    parallel_seeds,
    schedulable_buffers,
    serial_envs,
)


def test_a_collector_steps_from_the_carried_root():
    collector = Collector(CountingEnv(max_steps=100), None, frames_per_batch=2, total_frames=-1)
    batches = iter(collector)
    batch = next(batches)
    root = carried_root(collector)
    assert torch.equal(root["observation"], batch["next", "observation"][-1])
    root["observation"] = torch.full_like(root["observation"], 50)
    assert int(next(batches)["observation"][0]) == 50
    collector.shutdown()


def test_the_env_around_a_transform():
    counter = StepCounter()
    assert env_around(counter) is None
    stack = Compose(Compose(counter))
    assert env_around(counter) is None
    env = TransformedEnv(CountingEnv(), stack)
    assert env_around(counter) is env


@pytest.mark.parametrize("make", [partial(ParallelEnv, 2), partial(SerialEnv, 2)])
def test_batched_envs_know_what_they_were_seeded_with(make):
    env = make(CountingEnv)
    try:
        if isinstance(env, SerialEnv):
            assert not serial_envs(env)
            env.reset()
            assert [type(part) for part in serial_envs(env)] == [CountingEnv] * 2
            return
        assert not parallel_seeds(env)
        env.set_seed(5)
        first = parallel_seeds(env)
        assert first[0] == 5
        assert len(first) == 2
        env.set_seed(5)
        assert parallel_seeds(env) == first
        assert parallel_seeds(env) is not first
    finally:
        env.close(raise_if_closed=False)


class Noting(AfterStepTransform):
    def __init__(self):
        super().__init__()
        self.seen = []

    def after_step(self, step, root):
        self.seen.append((int(step["next", "observation"]), int(root["observation"])))
        step["next"].pop("observation")

    def _reset(self, tensordict, tensordict_reset):
        return tensordict_reset


def test_a_transform_sees_each_step_once_with_the_root_of_the_next():
    env = TransformedEnv(CountingEnv(max_steps=100), Noting())
    carried = env.reset()
    for count in (1, 2):
        step, carried = env.step_and_maybe_reset(carried.set("action", torch.ones(1, dtype=torch.int32)))
        assert env.transform.seen[-1] == (count, count)
        assert "observation" not in step["next"]
        assert int(carried["observation"]) == count
    assert len(env.transform.seen) == 2


def test_such_a_transform_is_refused_in_workers():
    with pytest.raises(RuntimeError, match="Noting cannot be part of what a batched env runs: wrap the ParallelEnv"):
        SerialEnv(2, lambda: TransformedEnv(CountingEnv(), Noting()))


class Extended(ExtensibleClipPPOLoss):
    """Notes the private methods that are called, and has a term of its own."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.called = []
        self._renew_keys()

    def further_in_keys(self):
        return ["wind"]

    def further_out_keys(self):
        return ["loss_wind"]

    def forward(self, tensordict):
        return super().forward(self._act(tensordict))

    def _get_cur_log_prob(self, *arguments, **options):
        self.called.append("_get_cur_log_prob")
        return super()._get_cur_log_prob(*arguments, **options)

    def _get_entropy(self, *arguments, **options):
        self.called.append("_get_entropy")
        return super()._get_entropy(*arguments, **options)


@pytest.fixture
def networks():
    torch.manual_seed(0)
    module = TensorDictModule(
        nn.Sequential(nn.Linear(3, 4), NormalParamExtractor()), in_keys=["observation"], out_keys=["loc", "scale"]
    )
    actor = ProbabilisticActor(
        module, in_keys=["loc", "scale"], distribution_class=IndependentNormal, return_log_prob=True
    )
    return actor, ValueOperator(nn.Linear(3, 1), in_keys=["observation"])


@pytest.fixture
def batch(networks):
    actor, _ = networks
    after = {"reward": torch.randn(8, 1), "observation": torch.randn(8, 3)}
    after |= {name: torch.zeros(8, 1, dtype=torch.bool) for name in ("done", "terminated")}
    data = TensorDict({"observation": torch.randn(8, 3), "next": after}, [8])
    data["advantage"], data["value_target"] = torch.randn(8, 1), torch.randn(8, 1)
    with torch.no_grad():
        return actor(data)


def test_ppo_asks_for_the_log_probability_and_the_entropy_and_runs_the_actor_no_second_time(networks, batch):
    actor, critic = networks
    loss, stock = Extended(actor, critic), ClipPPOLoss(actor, critic)
    runs = []
    actor.module[0].register_forward_hook(lambda *_: runs.append(1))
    ours = loss(batch)
    assert sorted(loss.called) == ["_get_cur_log_prob", "_get_entropy"]
    assert len(runs) == 1
    theirs = stock(batch)
    for name in ("loss_objective", "loss_entropy", "loss_critic", "kl_approx"):
        torch.testing.assert_close(ours[name], theirs[name])


def test_keys_of_further_terms_are_among_the_losss(networks):
    loss = Extended(*networks)
    assert "wind" in loss.in_keys
    assert {"loss_objective", "loss_wind"} <= set(loss.out_keys)
    loss.set_keys(advantage="gain")
    assert {"wind", "observation"} <= set(loss.in_keys)


def test_terms_are_reduced_where_the_mask_is_true(networks, batch):
    loss = Extended(*networks)
    assert "shifted_valid" in loss._mask_keys
    values = torch.arange(8.0)
    assert float(loss._reduced(values, batch)) == 3.5
    batch["shifted_valid"] = torch.tensor([True, True] + [False] * 6)
    assert float(loss._reduced(values, batch)) == 0.5


def test_coefficients_that_may_be_set(networks):
    loss = Extended(*networks)
    names = schedulable_buffers(loss)
    assert {"clip_epsilon", "entropy_coeff"} <= set(names)
    loss.clip_epsilon = 0.3
    assert float(loss.clip_epsilon) == pytest.approx(0.3)


def test_no_other_module_touches_them():
    """Private names are called in one place: ``x._name`` of what is not ``self`` and not ours."""
    names = (
        "_carrier|_container|_seeds|_envs|_post_step_mdp_hooks|_check_batched_worker_compat|_all_schedulable_buffers"
    )
    names += "|_reduce_loss|_loss_mask_keys|_get_cur_log_prob|_get_entropy|_set_in_keys|_in_keys|_out_keys|_new_unsafe"
    root = Path(__file__).parents[1]
    command = ["git", "grep", "-lwE", rf"(\.|\")({names})", "--", "torchrl_atr"]
    found = subprocess.run(command, cwd=root, capture_output=True, text=True).stdout.split()
    assert found in (["torchrl_atr/_torchrl_private.py"], [])  # the latter outside of a clone

"""Collection in this process and in workers: one contract."""

from __future__ import annotations

import os
import time
from functools import partial
from importlib.util import find_spec

import pytest
import torch
from torchrl.envs import TransformedEnv

from torchrl_atr._errors import InputError
from torchrl_atr.envs import RidingEnv, reconfigure
from torchrl_atr.envs.transforms import ObservationHistory, RandomizedStepCounter
from torchrl_atr.modules import with_correlated_noise
from torchrl_atr.training import ConfigError, Learner, make_config, make_env, make_run_networks
from torchrl_atr.training.collection import Collection, CollectionError, _worker_env

needs_ray = pytest.param(
    "ray", marks=pytest.mark.skipif(find_spec("ray") is None, reason="Ray is an extra: pip install 'torchrl_atr[ray]'")
)
TINY = {"env.num_envs": 8, "ppo.rollout_steps": 4, "ppo.minibatches": 1, "compute.num_threads": 1, "compute.workers": 2}


SHORT = {
    "env.episode_seconds": 0.2,
    "env.first_episode_seconds": 0.0,
    "curriculum.command_seconds": 0.1,
    "curriculum.score_from_seconds": 0.0,
}


def start(collector):
    config = make_config({**TINY, **SHORT, "compute.collector": collector})
    torch.manual_seed(0)
    env = make_env(config)
    networks = make_run_networks(config, env)
    learner = Learner(networks, config)
    policy = with_correlated_noise(networks.rollout_policy(config.roa.act_source), config.exploration.noise_correlation)
    return config, learner, Collection(config, env, partial(make_env, config), policy)


@pytest.mark.parametrize("collector", ["direct", "process", "distributed", needs_ray])
def test_batches_are_of_the_policy_as_it_is_and_curricula_merge(collector):
    """Recorded log-probabilities are the learner's own, before and after it moved; workers draw different robots."""
    config, learner, collection = start(collector)
    networks = learner.networks
    try:
        for _ in range(3):
            batch = collection.collect()
            assert batch.shape == (8, 4)
            flat = batch.reshape(-1)
            with torch.no_grad():
                log_prob = (
                    networks.training_actor(config.roa.act_source).get_dist(flat.clone()).log_prob(flat["action"])
                )
            torch.testing.assert_close(log_prob, flat["action_log_prob"], rtol=0, atol=1e-5)
            learner.update(batch)
            cell = (0, 0)  # far from any command: only an exchange can raise it elsewhere
            collection.curriculum.weights[cell] = 0.75
            collection.exchange()
            assert collection.curriculum.weights[cell] == 0.75
            if collection.can_call_workers:
                for weights in collection.collector.get_distant_attr("env.curriculum.weights"):
                    torch.testing.assert_close(weights, collection.curriculum.weights)
        intrinsics = batch["privileged", "intrinsic"][:, 0]
        assert len(torch.unique(intrinsics, dim=0)) == 8
        assert collection.num_diverged == (0 if collection.can_call_workers or not collection.remote else None)
        envs_change_while_they_run(collection)
    finally:
        collection.shutdown()


def envs_change_while_they_run(collection):
    """Every robot's next episode has the new intrinsics and command; a name or a value that does not fit changes none.

    Part of the test above, as workers take seconds to start.
    """
    if collection.remote and not collection.can_call_workers:
        with pytest.raises(InputError, match="collector='distributed' cannot call its workers; use process or ray"):
            collection.reconfigure(randomization="off")
        return
    collection.reconfigure(randomization={"payload": (0.25, 0.25)}, command_bounds=(0.4, 0.2), sensors="realistic")
    for wrong in ({"randomizatoin": "off"}, {"randomization": {"payload": (9.0, 1.0)}}):
        with pytest.raises(InputError, match="randomization"):
            reconfigure(collection.collector, **wrong)  # asks the workers
        with pytest.raises(InputError, match="randomization"):
            collection.reconfigure(**wrong)
    columns = collection.env.base_env.runner.intrinsics.slices["payload"]
    scaled = collection.env.base_env.task.intrinsics["payload"].scaled(0.25)
    for _ in range(2 * 10 // 4 + 1):  # steps of two episodes / those of a batch
        batch = collection.collect()
    payload = batch["privileged", "intrinsic"][..., columns]
    torch.testing.assert_close(payload, torch.full_like(payload, scaled))
    assert bool((batch["command"].abs() <= torch.tensor([0.4, 0.2])).all())


def test_an_older_checkpoint_carries_reward_terms_no_further():
    *_, collection = start("direct")
    collection.collect()
    state = collection.state_dict()
    state["carried"]["reward_terms"] = {"termination": torch.zeros(8, 1)}
    collection.load_state_dict(state)
    assert "reward_terms" not in collection.collector._carrier
    collection.shutdown()


def test_what_the_learner_adds_to_a_batch_is_not_in_the_next_one():
    _, learner, collection = start("direct")
    batch = collection.collect()
    collected = set(batch.keys(True, True))
    learner.update(batch)
    assert set(collection.collect().keys(True, True)) == collected
    collection.shutdown()


def test_robots_must_divide_among_the_workers():
    with pytest.raises(ConfigError, match=r"num_envs=7 cannot be shared evenly by compute.workers=2"):
        make_config({**TINY, "env.num_envs": 7, "compute.collector": "process"})
    with pytest.raises(ConfigError, match="collector='ssh' is unknown; choose one of direct, process, ray"):
        make_config({"compute.collector": "ssh"})


def kill_a_worker(collection):
    """SIGKILL; returns the processes of the local engines."""
    if collection.config.compute.collector == "ray":
        import ray

        ray.kill(collection.collector.remote_collectors[-1])
        return []
    workers = list(
        collection.collector.procs if collection.config.compute.collector == "process" else collection.collector.jobs
    )
    workers[-1].kill()
    return [worker.pid for worker in workers]


def go_on(collection):
    while True:
        collection.collect()
        collection.exchange()


@pytest.mark.parametrize("collector", ["process", "distributed", needs_ray])
def test_a_killed_worker_is_a_named_error_and_leaves_no_orphans(collector):
    _, _, collection = start(collector)
    collection.collect()
    pids, killed = kill_a_worker(collection), time.monotonic()
    with pytest.raises(CollectionError, match=f"collector='{collector}': a worker failed .* --resume"):
        go_on(collection)
    collection.shutdown()
    assert time.monotonic() - killed < 60
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_workers_of_a_resumed_run_are_where_the_time_limit_has_grown_to():
    config = make_config({**TINY, "total_frames": 8 * 10_000, "compute.collector": "process"})
    limits = {}
    for started in (0, 100, 10_000):
        env = _worker_env(partial(make_env, config), None, 4 * started, num_envs=4, seed=0, num_threads=1)
        env.reset()
        (counter,) = (part for part in env.transform if isinstance(part, RandomizedStepCounter))
        limits[started] = counter.limit
    assert limits[0] == 250  # 5 s
    assert 250 < limits[100] < 1000
    assert limits[10_000] == 1000


@pytest.mark.parametrize("wrapped", [False, True])
def test_failures_of_an_env_with_one_transform_or_none_can_be_counted_in_workers(wrapped):
    def make(**share):
        env = RidingEnv(**share)
        return TransformedEnv(env, ObservationHistory(2)) if wrapped else env

    env = _worker_env(make, None, 0, num_envs=2, seed=0, num_threads=1)
    assert env.base_env.num_diverged == 0

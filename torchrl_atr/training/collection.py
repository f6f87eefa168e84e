"""Where batches come from: a collector in this process, or workers on TorchRL's own engines."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import BaseCollector, Collector
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType

from torchrl_atr.envs.transforms import CommandCurriculum
from torchrl_atr.training.config import TrainConfig

_DROPPED: tuple[Any, ...] = (("next", "history"), "reward_terms", "episode_reward", ("next", "command"))
# Neither GAE nor the losses read these; the next history alone would be a third of a batch.
_CURRICULUM = "env.transform[0]"


class Collection:
    """Batches (N, T) of a policy that is being trained, from one or more batched envs.

    With ``collector="direct"`` the env of this process is stepped; otherwise each of ``workers`` processes steps its
    share of the robots with its share of the CPUs, and the workers' curricula are merged by :meth:`exchange`.

    Args:
        config: of the run.
        env: this process's env; its first transform is the curriculum that is saved and shown.
        make_env: ``make_env(num_envs=n, seed=s, num_threads=t)`` for a worker.
        policy: shared with the learner.
    """

    def __init__(
        self,
        config: TrainConfig,
        env: TransformedEnv,
        make_env: Callable[..., TransformedEnv],
        policy: TensorDictModuleBase,
    ) -> None:
        self.config, self.env = config, env
        self.curriculum: CommandCurriculum = env.transform[0]
        self.remote = config.collector != "direct"
        self.collector = self._make(make_env, policy)
        if self.remote:
            self._spread()

    def _make(self, make_env: Callable[..., TransformedEnv], policy: TensorDictModuleBase) -> BaseCollector:
        config = self.config
        common: dict[str, Any] = {
            "frames_per_batch": config.frames_per_batch,
            "total_frames": -1,
            "exploration_type": ExplorationType.RANDOM,
            "policy_device": config.device,
            "env_device": "cpu",
            "storing_device": "cpu",
            "postproc": _drop,
            "auto_register_policy_transforms": False,
        }
        if not self.remote:
            return Collector(self.env, policy, **common)
        share, cpus = config.num_envs // config.workers, config.num_threads or len(os.sched_getaffinity(0))
        makers = [
            partial(
                make_env, num_envs=share, seed=config.seed + 1000 * worker, num_threads=max(1, cpus // config.workers)
            )
            for worker in range(config.workers)
        ]
        return Collector(makers, policy, num_collectors=config.workers, sync=True, cat_results=0, **common)

    def __iter__(self) -> Iterator[TensorDictBase]:
        return iter(self.collector)

    def publish(self) -> None:
        """Hands the learner's parameters to the workers."""
        if self.remote:
            self.collector.update_policy_weights_()

    @torch.no_grad()
    def exchange(self) -> None:
        """Merges the workers' curricula by elementwise maximum and gives the result back to all of them."""
        if not self.remote:
            return
        for weights in self.collector.get_distant_attr(f"{_CURRICULUM}.weights"):
            self.curriculum.merge_(weights)
        self._spread()

    def _spread(self) -> None:
        arguments = [(self.curriculum.weights.clone(),)] * self.config.workers
        self.collector.map_fn(f"{_CURRICULUM}.load_weights", list_of_args=arguments)

    @property
    def num_diverged(self) -> int:
        """Simulations that have diverged so far."""
        if not self.remote:
            return self.env.base_env.num_diverged
        return sum(self.collector.get_distant_attr("env.base_env.num_diverged"))

    def shutdown(self) -> None:
        """Ends the workers; this process's env stays open."""
        self.collector.shutdown(**({} if self.remote else {"close_env": False}))


def _drop(batch: TensorDictBase) -> TensorDictBase:
    return batch.exclude(*_DROPPED)

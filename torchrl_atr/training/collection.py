"""Collection of batches, by a collector in this process or by workers of TorchRL's backends."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import BaseCollector, Collector
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType

from torchrl_atr._cpus import available_cpus
from torchrl_atr._errors import InputError, UserError, first_line
from torchrl_atr._torchrl_private import carried_root
from torchrl_atr.config import TrainConfig
from torchrl_atr.envs import reconfigure
from torchrl_atr.envs.access import transforms_of
from torchrl_atr.envs.transforms.step_counter import RandomizedStepCounter
from torchrl_atr.modules import DeviceBridge, with_state
from torchrl_atr.modules.estimators import state_keys
from torchrl_atr.training.env_access import attribute, curriculum_of, env_state, load_env_state

_PLAIN = {"auto_register_policy_transforms": False}
"""Arguments of a collector whose env has the policy's transforms."""
_CURRICULUM = "env.curriculum"
_ENDLESS = 2**62
"""Frames, for the backends that do not read -1 as endless."""
_WORKER_STRIDE, _RESUME_STRIDE = 1000, 7919
"""Differences of the seeds of two workers, and of a worker that starts at one iteration and at the next."""


class CollectionError(UserError, RuntimeError):
    """Error of workers that could not be started, or died."""


class Collection:
    """Source of batches (N, T) of a policy that is being trained, from one or more batched envs.

    With ``collector="direct"`` the env of this process is stepped; otherwise each of ``workers`` steps its share of the
    robots with its share of the CPUs. The curricula of ``process`` and ``ray`` workers are merged by :meth:`exchange`;
    ``distributed`` workers cannot be called from here, so that each grows its own.

    Args:
        config: of the run.
        env: this process's env; a curriculum that it has as ``env.curriculum`` is the one that is saved and shown.
        make_env: ``make_env(num_envs=n, seed=s, num_threads=t)`` for a worker.
        policy: shared with the learner.
        started: iterations that the run has completed, so that workers of a resumed run draw other robots.

    Raises:
        CollectionError: if a worker dies, here or in any method.
    """

    def __init__(
        self,
        config: TrainConfig,
        env: EnvBase,
        make_env: Callable[..., EnvBase],
        policy: TensorDictModuleBase,
        started: int = 0,
    ) -> None:
        self.recurrent = bool(state_keys(policy))
        self.config, self.policy = config, policy
        self.env = with_state(env, policy) if config.compute.collector == "direct" else env
        self.curriculum = curriculum_of(env)
        self.remote = config.compute.collector != "direct"
        self.can_call_workers = config.compute.collector in ("process", "ray")
        self._broken, self._started = False, started
        self._others = set(multiprocessing.active_children())  # started by other code
        try:
            with self._workers("could not be started"):
                self.collector = self._make(make_env)
                self.exchange()
                self._batches = iter(self.collector)
        except CollectionError:
            self.shutdown()
            raise

    def _make(self, make_env: Callable[..., EnvBase]) -> BaseCollector:
        config = self.config
        common: dict[str, Any] = {
            "frames_per_batch": config.frames_per_batch,
            "exploration_type": ExplorationType.RANDOM,
            "policy_device": config.compute.device if self.remote else "cpu",
            "env_device": "cpu",
            "storing_device": "cpu",
        }
        if not self.remote:
            plain = {"track_traj_ids": False, "return_same_td": True, "trust_policy": True, **_PLAIN}
            captured = config.captures_graphs and not self.recurrent  # it branches on is_init, a CUDA graph cannot
            return Collector(self.env, _for_cpu_data(self.policy, config, captured), **plain, **common)
        threads = max(1, (config.compute.num_threads or available_cpus()) // config.compute.workers)
        weights = None if self.curriculum is None else self.curriculum.weights.clone()
        makers = [
            partial(
                _worker_env,
                make_env,
                weights,
                self._started * config.ppo.rollout_steps,
                num_envs=config.env.num_envs // config.compute.workers,
                seed=(config.seed + _WORKER_STRIDE * (worker + 1) + _RESUME_STRIDE * self._started) % 2**31,
                num_threads=threads,
            )
            for worker in range(config.compute.workers)
        ]
        return Collector(
            makers,
            self.policy,
            num_collectors=config.compute.workers,
            sync=True,
            **common,
            **_backend_arguments(config, threads, {"auto_register_policy_transforms": self.recurrent}),
        )

    def collect(self) -> TensorDictBase:
        """Return the next batch, (N, T), in memory that the one after it may overwrite."""
        with self._workers():
            batch = next(self._batches)
        return batch.contiguous().flatten(0, 1) if batch.ndim == 3 else batch  # stacked lazily by worker

    @torch.no_grad()
    def exchange(self) -> None:
        """Send the learner's parameters to the workers, and to each the elementwise maximum of all curricula."""
        if not self.remote:
            return
        with self._workers():
            self.collector.update_policy_weights_()
            if self.can_call_workers and self.curriculum is not None:
                for weights in self.collector.get_distant_attr(f"{_CURRICULUM}.weights"):
                    self.curriculum.merge_(weights)
                arguments = [(self.curriculum.weights.clone(),)] * self.config.compute.workers
                self.collector.map_fn(f"{_CURRICULUM}.load_weights", list_of_args=arguments)

    def reconfigure(self, **changes: Any) -> None:
        """Change parameters of all envs from their next episodes on: :func:`torchrl_atr.envs.reconfigure`.

        Changes are not part of a checkpoint: a callback makes them again when a run is resumed.

        Raises:
            InputError: names what does not fit; nothing has changed then. With ``distributed``, whose workers cannot be
                called, always.
        """
        if self.remote and not self.can_call_workers:
            raise InputError(f"collector={self.config.compute.collector!r} cannot call its workers; use process or ray")
        reconfigure(self.env, **changes)  # refused here, before any worker is asked
        if self.remote:
            with self._workers():
                reconfigure(self.collector, **changes)

    @contextmanager
    def _workers(self, what: str = "failed") -> Iterator[None]:
        """Turn the errors that TorchRL's backends raise when a worker is gone into a :class:`CollectionError`."""
        try:
            yield
        except Exception as error:
            if not self.remote:
                raise
            self._broken = True
            raise CollectionError(
                f"collector={self.config.compute.collector!r}: a worker {what} ({first_line(error)}, see above); "
                "continue from the last checkpoint with --resume"
            ) from error

    @property
    def num_diverged(self) -> int | None:
        """Number of failed robots so far; None where workers cannot be asked, or the env does not count them."""
        here = attribute(self.env, "num_diverged")
        if not self.remote or here is None:
            return here
        if not self.can_call_workers:
            return None
        with self._workers():
            return sum(self.collector.get_distant_attr("env.base_env.num_diverged"))

    def metrics(self) -> dict[str, float]:
        """Return the extent of the commands, where there is a curriculum, and ``diverged``, where it is known."""
        metrics: dict[str, float] = {}
        if self.curriculum is not None:
            metrics["command_area"] = self.curriculum.command_area[0]
            metrics["frontier_speed"], metrics["frontier_yaw_rate"] = self.curriculum.frontier
        diverged = self.num_diverged  # asks the workers
        return metrics if diverged is None else {**metrics, "diverged": diverged}

    def state_dict(self) -> dict[str, Any]:
        """Return the state that the next batch depends on besides the networks, in tensors.

        It is empty with workers and for an env without a state of its own: a resumed run then starts new episodes.
        """
        env = {} if self.remote else env_state(self.env)
        if not env:
            return {}
        return {
            **env,
            "policy": {name: part.get_extra_state() for name, part in self._parts_with_extra_state()},
            "carried": carried_root(self.collector).to_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore :meth:`state_dict`; a CheckpointError says that it is of other transforms."""
        if self.remote or not state:
            return
        load_env_state(self.env, state)
        for name, part in self._parts_with_extra_state():
            part.set_extra_state(state["policy"][name])
        carried = TensorDict(state["carried"], batch_size=self.env.batch_size)
        carried_root(self.collector).update(carried.exclude("reward_terms"))  # in earlier checkpoints

    def _parts_with_extra_state(self) -> list[tuple[str, Any]]:
        """Return name and module of the policy's parts with a state beside parameters, such as correlated noise."""
        plain = torch.nn.Module.get_extra_state
        return [(name, part) for name, part in self.policy.named_modules() if type(part).get_extra_state is not plain]

    def shutdown(self) -> None:
        """End the workers, whatever state they are in; this process's env stays open."""
        if not self.remote:
            self.collector.shutdown(close_env=False)
            return
        try:
            if hasattr(self, "collector"):  # it was made
                self.collector.shutdown()
        except RuntimeError:
            if not self._broken:  # else it waited for the answer of a worker that is gone
                raise
        finally:
            if self._broken:  # the collector may not have reached its workers, or not exist
                for process in set(multiprocessing.active_children()) - self._others:
                    process.kill()
                    process.join()
            if torch.distributed.is_initialized():
                torch.distributed.destroy_process_group()


def _for_cpu_data(
    policy: TensorDictModuleBase, config: TrainConfig, captured: bool
) -> Callable[[TensorDictBase], TensorDictBase]:
    """Return the policy, on any device, as a function of CPU data; as a module it would be copied to the CPU."""
    device = config.compute.device
    return policy if device == "cpu" else DeviceBridge(policy, device, captured).forward


def _backend_arguments(config: TrainConfig, threads: int, of_each: dict[str, Any]) -> dict[str, Any]:
    """Return the backend-specific arguments of TorchRL's ``Collector``; each worker needs ``threads`` CPUs."""
    if config.compute.collector == "process":
        # workers wait while the learner computes: it keeps all of its threads
        return {"total_frames": -1, "cat_results": 0, "num_threads": torch.get_num_threads(), **of_each}
    if config.compute.collector == "ray":
        here = {"num_cpus": config.compute.workers * threads, "include_dashboard": False}
        cluster = {} if os.environ.get("RAY_ADDRESS") else here  # a cluster has its own resources
        options: dict[str, Any] = {"ray_init_config": cluster, "remote_configs": {"num_cpus": threads, "num_gpus": 0}}
    else:
        from torch.distributed.elastic.utils.distributed import get_free_port

        options = {"launcher": "mp", "backend": "gloo", "tcp_port": get_free_port()}
    options["collector_kwargs"] = of_each
    return {"backend": config.compute.collector, "total_frames": _ENDLESS, "backend_options": options}


def _worker_env(
    make_env: Callable[..., EnvBase], weights: Tensor | None, steps: int, *, seed: int, **share: Any
) -> EnvBase:
    """Return a worker's env with the current curriculum; seed the exploration of the process it is made in.

    Its time limit grows as in an env that has taken that number of ``steps``. It is a transformed env, on whose base
    :attr:`Collection.num_diverged` counts.
    """
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the trainer decides
    torch.manual_seed(seed)
    env = make_env(seed=seed, **share)
    env = env if isinstance(env, TransformedEnv) else TransformedEnv(env)
    for part in transforms_of(env):
        if isinstance(part, RandomizedStepCounter) and part.growth is not None:
            begin, end = part.growth.begin - steps, part.growth.end - steps
            part.growth = part.growth._replace(begin=begin, end=end)
    if weights is not None:
        env.curriculum.load_weights(weights)
    return env

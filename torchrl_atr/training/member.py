"""One process's part of every iteration: its robots ride, its copy of the learner learns."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import mean
from types import MappingProxyType
from typing import Any

import torch
from torchrl.envs import EnvBase

from torchrl_atr._files import say
from torchrl_atr._threads import TorchThreads
from torchrl_atr.training.assembly import make_policy, make_reward_schedule
from torchrl_atr.training.callbacks import Callbacks
from torchrl_atr.training.collection import Collection
from torchrl_atr.training.config import TrainConfig
from torchrl_atr.training.env_access import curriculum_of
from torchrl_atr.training.learner import Learner
from torchrl_atr.training.metrics import batch_metrics
from torchrl_atr.training.parts import Parts
from torchrl_atr.training.team import Team


class Member:
    """Robots, collection and learner of one process, and its team.

    The leader says what is done next, by name: :meth:`lead` there, :meth:`follow` elsewhere.

    Args:
        learner: whose networks ride.
        collection: of this process's robots.
        team: those it learns with.
        threads: of torch, adapted at every iteration.
    """

    def __init__(self, learner: Learner, collection: Collection, team: Team, threads: TorchThreads) -> None:
        self.learner, self.collection, self.team, self.threads = learner, collection, team, threads

    def lead(self, name: str, *arguments: Any) -> Any:
        """Has every member call its method ``name``; returns what the leader's returns."""
        self.team.share((name, arguments))
        return getattr(self, name)(*arguments)

    def follow(self) -> None:
        """Does what the leader says, until it dismisses the team."""
        while (order := self.team.share(None)) is not None:
            name, arguments = order
            getattr(self, name)(*arguments)

    def iterate(self, progress: float) -> dict[str, float]:
        """Collects a batch and learns from it.

        Args:
            progress: share of the run that is over, in [0, 1].

        Returns:
            In the leader, metrics of all batches.
        """
        self.threads.update()
        self.learner.anneal(progress)
        started = time.monotonic()
        batch = self.learner.callbacks.batch(self.collection.collect())
        collected = time.monotonic()
        metrics = batch_metrics(batch)
        metrics.update(self.learner.update(batch))
        curriculum = self.collection.curriculum
        if self.team.size > 1:
            state = self.learner.state_dict()
            learned = {name: state[name] for name in ("networks", "deployed", "optimizers")}  # normalisers, rates too
            self.learner.load_state_dict({**state, **self.team.average(learned)})
            if curriculum is not None:
                curriculum.merge_(self.team.maximum(curriculum.weights))
        self.collection.publish()
        self.collection.exchange()
        if curriculum is not None:
            metrics["command_area"] = curriculum.command_area[0]
            metrics["frontier_speed"], metrics["frontier_yaw_rate"] = curriculum.frontier
        metrics["std"] = float(self.learner.networks.exploration.std().detach().mean())
        diverged = self.collection.num_diverged  # asks the workers
        if diverged is not None:
            metrics["diverged"] = diverged
        metrics["torch_threads"] = self.threads.count
        metrics["collect_seconds"], metrics["learn_seconds"] = collected - started, time.monotonic() - collected
        return _summary(self.team.gather(metrics))

    def state(self) -> list[dict[str, Any]]:
        """In the leader, what every member's next batch depends on besides the networks, by rank."""
        return self.team.gather(member_state(self.learner.callbacks, self.collection.state_dict()))

    def load_state(self, state: dict[str, Any]) -> None:
        """Restores one member's part of :meth:`state`, but for its callbacks."""
        self.collection.load_state_dict(state["collection"])
        torch.set_rng_state(state["rng"])  # last: building all this drew from it


def torch_threads(config: TrainConfig, announce: Callable[[str], object] | None = say) -> TorchThreads:
    """Return torch's threads for one process of a run, as a context manager."""
    share = 0 if config.compute.learners == 1 else config.threads_each(config.compute.learners)
    return TorchThreads(
        config.compute.torch_threads or share, adaptive=config.compute.torch_threads == 0, announce=announce
    )


def member_state(callbacks: Callbacks, collection: Mapping[str, Any] = MappingProxyType({})) -> dict[str, Any]:
    """Return what one member's next batch depends on besides the networks, and the states of its callbacks."""
    return {"collection": dict(collection), "callbacks": callbacks.state_dict(), "rng": torch.get_rng_state()}


def make_learner(networks: Any, config: TrainConfig, env: EnvBase, parts: Parts, loss: Any = None) -> Learner:
    """Return the learner of one process.

    Args:
        networks: of the run, where they are trained.
        config: of this process's share.
        env: its env.
        parts: of the run.
        loss: from ``parts``, where it has been made.
    """
    own = parts.loss(config, networks) if loss is None else loss
    return Learner(networks, config, own, make_reward_schedule(env), parts.callbacks)


def make_member(
    learner: Learner,
    env: EnvBase,
    team: Team,
    make_env: Callable[..., EnvBase],
    threads: TorchThreads,
    started: int = 0,
) -> Member:
    """A member around a learner and an env; workers start.

    Args:
        learner: with the configuration of this process's share.
        env: its env.
        team: those it learns with.
        make_env: from :meth:`~torchrl_atr.training.parts.Parts.env_maker`, for workers.
        threads: of torch.
        started: iterations that the run has behind it.
    """
    config = learner.config
    policy = make_policy(config, learner.networks)
    return Member(learner, Collection(config, env, make_env, policy, started), team, threads)


def assist(team: Team, config: TrainConfig, run: Path, parts: Parts) -> None:
    """What a helper's process does: makes its own robots and networks, takes over what the leader has, and follows.

    Args:
        team: as this process knows it.
        config: of the run.
        run: the run folder.
        parts: of the run, but for what the leader alone needs.
    """
    share = config.share(team.rank)
    make_env = parts.env_maker(share, run)
    torch.manual_seed(share.seed)
    with torch_threads(config, announce=None) as threads:  # the leader's line is enough
        env = make_env()
        learner = make_learner(parts.networks(share, env), share, env, parts)
        start = team.share(None)
        learner.load_state_dict(start["learner"])
        if (curriculum := curriculum_of(env)) is not None:
            curriculum.load_weights(start["curriculum"]["weights"])
        member = make_member(learner, env, team, make_env, threads, start["iteration"])
        if start["members"]:
            own = start["members"][team.rank]
            member.load_state(own)
            parts.callbacks.load_state_dict(own.get("callbacks", {}))
        member.follow()


def _summary(members: Sequence[dict[str, float]]) -> dict[str, float]:
    """Means over the members that have a metric; the sum of failed simulations, the most of skipped steps."""
    names = dict.fromkeys(name for metrics in members for name in metrics)
    known = {name: [metrics[name] for metrics in members if name in metrics] for name in names}
    special: dict[str, Callable[[list[float]], float]] = {"diverged": sum, "skipped_steps": max}
    return {name: special.get(name, mean)(each) for name, each in known.items()}

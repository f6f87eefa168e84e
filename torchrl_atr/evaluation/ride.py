"""Robots that ride commands under a policy, as every evaluation has them: from rest, and who falls stays down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from torchrl_atr.evaluation.access import achieved_speeds, command_owner, deterministic
from torchrl_atr.modules.keys import NetworkKeys

MAX_ROBOTS = 1024
"""Robots simulated at once; larger evaluations go in chunks."""


class MakeEnv(Protocol):
    """Builds a chunk's env, such as ``partial(make_riding_env, "a1", "single_board", pushes=False)``."""

    def __call__(self, *, num_envs: int, seed: int) -> EnvBase:
        """An env of ``num_envs`` robots whose transform pins commands."""
        ...


@dataclass
class RideStep:
    """One control step of n robots.

    Attributes:
        index: steps before it.
        command: in force during it, (n, C).
        observed: what the env emitted before it.
        decided: what the policy wrote.
        up: which robots were up before it, (n,) bool.
        speeds: what answers the command after it, (n, C).
        down: which robots are down after it: those that were, and those whose episode the env ended in it, (n,) bool.
            Whoever is told of the step may add more.
    """

    index: int
    command: Tensor
    observed: TensorDictBase
    decided: TensorDictBase
    up: Tensor
    speeds: Tensor
    down: Tensor


Watch = TypeVar("Watch", bound=Callable[[RideStep], None])


def ride(
    policy: TensorDictModuleBase,
    env: EnvBase,
    commands: Tensor,
    total: int,
    watch: Callable[[RideStep], None],
    *,
    command_steps: int | None = None,
    speeds: Callable[[EnvBase], Tensor] = achieved_speeds,
    keys: NetworkKeys | None = None,
) -> None:
    """Ride ``total`` steps from a reset, without exploration; ``watch`` is told of each.

    The policy is handed its own ``in_keys`` and nothing else. Nothing is reset: a robot that fell stays down, and acts
    no more.

    Args:
        policy: writes the action.
        env: of n robots, whose transform pins commands.
        commands: one after the other, (K, n, C); the last one stays.
        total: control steps.
        watch: called after each step.
        command_steps: how long a command lasts; None for ever.
        speeds: measures what answers the command of the env's robots, (n, C).
        keys: names of the TensorDict entries, if the env has its own.

    Raises:
        TypeError: if the env cannot pin commands, or cannot be measured.
    """
    owner, action, lasts = command_owner(env), (keys or NetworkKeys()).action, command_steps or total
    up = torch.ones(commands.shape[1], dtype=torch.bool)
    owner.pin(commands[0])
    with deterministic(policy):
        td = env.reset()
        for index in range(total):
            number = min(index // lasts, len(commands) - 1)
            observed = td
            decided = policy(td.select(*policy.in_keys, strict=False))
            td = td.copy().update(decided)
            # what a fallen robot's policy says may be anything; the env would refuse a NaN
            td[action] = td[action].where(up.unsqueeze(-1), torch.zeros(()))
            if (index + 1) % lasts == 0 and number + 1 < len(commands):
                owner.pin(commands[number + 1])  # shows in what this step leads to: the next one answers it
            td = env.step(td)
            down = ~up | td["next", "terminated"].reshape(-1)
            step = RideStep(index, commands[number], observed, decided, up, speeds(env), down)
            watch(step)
            up = ~step.down
            td = step_mdp(td)


def ride_in_chunks(
    policy: TensorDictModuleBase,
    make_env: MakeEnv,
    commands: Tensor,
    total: int,
    make_watch: Callable[[EnvBase, Tensor], Watch],
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> list[Watch]:
    """Ride with any number of robots, at most :data:`MAX_ROBOTS` at once, and return each chunk's watch.

    Args:
        policy: writes the action.
        make_env: called as ``make_env(num_envs=n, seed=s)``.
        commands: one after the other, (K, n, C).
        total: control steps.
        make_watch: from a chunk's env and its commands to what is told of its steps.
        seed: of the first chunk's env; the next ones count on from it.
        progress: called with (steps done, steps in total) after every step.
        **options: of :func:`ride`.

    Raises:
        ValueError: if ``make_env`` built another number of robots.
    """
    watches: list[Watch] = []
    parts = commands.split(MAX_ROBOTS, dim=1)
    for number, part in enumerate(parts):
        env = build_env(make_env, part.shape[1], seed + number)
        watch = make_watch(env, part)

        def told(step: RideStep, watch: Watch = watch, before: int = number * total) -> None:
            watch(step)
            if progress is not None:
                progress(before + step.index + 1, len(parts) * total)

        ride(policy, env, part, total, told, **options)
        env.close(raise_if_closed=False)
        watches.append(watch)
    return watches


def build_env(make_env: MakeEnv, num_envs: int, seed: int) -> EnvBase:
    """Return the env that ``make_env`` makes.

    Raises:
        ValueError: if it has another number of robots.
    """
    env = make_env(num_envs=num_envs, seed=seed)
    if env.batch_size != torch.Size([num_envs]):
        raise ValueError(f"make_env(num_envs={num_envs}) built an env of batch size {tuple(env.batch_size)}")
    return env


def key_name(key: NestedKey) -> str:
    """Return the name of an entry as one text.

    Example:
        >>> key_name(("privileged", "intrinsic"))
        'privileged.intrinsic'
    """
    return key if isinstance(key, str) else ".".join(key)

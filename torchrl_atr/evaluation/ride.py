"""Rollouts of a policy on pinned commands, shared by all evaluations: from rest, without a reset of fallen robots."""

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
from torchrl_atr.modules.estimators import with_state
from torchrl_atr.modules.keys import NetworkKeys

MAX_ROBOTS = 1024
"""Largest number of robots simulated at once; larger evaluations run in chunks."""


class MakeEnv(Protocol):
    """Factory of a chunk's env, such as ``partial(make_riding_env, "a1", "single_board", pushes=False)``."""

    def __call__(self, *, num_envs: int, seed: int) -> EnvBase:
        """Return an env of ``num_envs`` robots whose transform pins commands."""
        ...


@dataclass
class RideStep:
    """Control step of n robots.

    Attributes:
        index: number of steps before it.
        command: asked for during it, which an env may approach at a limited rate, (n, C).
        observed: the env's entries before it.
        decided: the policy's output.
        up: mask of the robots that were up before it, (n,) bool.
        speeds: achieved after it, one value per command component, (n, C).
        down: mask of the robots that are down after it, before or because the env ended their episode, (n,) bool.
            The watch may add more.
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
    until_down: bool = False,
) -> None:
    """Ride ``total`` steps from a reset, without exploration, and call ``watch`` after each.

    The policy gets its own ``in_keys`` and nothing else. Nothing is reset: a robot that fell stays down, and its action
    is zero.

    Args:
        policy: writes the action.
        env: of n robots, whose transform pins commands.
        commands: one after the other, (K, n, C); the last one stays.
        total: control steps.
        watch: called after each step.
        command_steps: duration of a command; None for the whole ride.
        speeds: measures the env's robots, one value per command component, (n, C).
        keys: names of the TensorDict entries, if the env has its own.
        until_down: end earlier once all robots are down.

    Raises:
        TypeError: if the env cannot pin commands, or has no achieved speeds.
    """
    env = with_state(env, policy)
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
            # the policy's output for a fallen robot may be anything; the env would refuse a NaN
            td[action] = td[action].where(up.unsqueeze(-1), torch.zeros(()))
            if (index + 1) % lasts == 0 and number + 1 < len(commands):
                owner.pin(commands[number + 1])  # observed after this step, so it is in force from the next one
            td = env.step(td)
            down = ~up | td["next", "terminated"].reshape(-1)
            step = RideStep(index, commands[number], observed, decided, up, speeds(env), down)
            watch(step)
            up = ~step.down
            if until_down and not up.any():
                break
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
        make_watch: returns the watch of a chunk, given its env and commands.
        seed: of the first chunk's env; further chunks have the seeds after it.
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

        def watch_part(step: RideStep, watch: Watch = watch, before: int = number * total) -> None:
            watch(step)
            if progress is not None:
                progress(before + step.index + 1, len(parts) * total)

        ride(policy, env, part, total, watch_part, **options)
        env.close(raise_if_closed=False)
        watches.append(watch)
    return watches


def build_env(make_env: MakeEnv, num_envs: int, seed: int) -> EnvBase:
    """Build an env and check its number of robots.

    Raises:
        ValueError: if ``make_env`` built another number of robots.
    """
    env = make_env(num_envs=num_envs, seed=seed)
    if env.batch_size != torch.Size([num_envs]):
        raise ValueError(f"make_env(num_envs={num_envs}) built an env of batch size {tuple(env.batch_size)}")
    return env


def key_name(key: NestedKey) -> str:
    """Return the name of an entry as one string.

    Example:
        >>> key_name(("privileged", "intrinsic"))
        'privileged.intrinsic'
    """
    return key if isinstance(key, str) else ".".join(key)

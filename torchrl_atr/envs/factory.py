"""``make_riding_env``: the env with the standard transforms, picklable through ``functools.partial``."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.envs import TransformedEnv

from torchrl_atr._registry import nearest
from torchrl_atr.envs.models import RobotSpec, TransporterSpec
from torchrl_atr.envs.profiles import Readings
from torchrl_atr.envs.riding import PhysicsEngine, RidingEnv
from torchrl_atr.envs.task.randomization import Randomization
from torchrl_atr.envs.task.reward_terms import RewardError, RewardTerm
from torchrl_atr.envs.task.rewards import RIDING_REWARDS
from torchrl_atr.envs.transforms import CommandCurriculum, CommandGrid, riding_transforms


class CurriculumEnv(TransformedEnv):
    """A transformed env with a command curriculum among its transforms, whatever its place."""

    @property
    def curriculum(self) -> CommandCurriculum:
        """The curriculum, which also pins commands."""
        return next(transform for transform in self.transform if isinstance(transform, CommandCurriculum))


def make_riding_env(
    robot: str | Path | RobotSpec = "a1",
    transporter: str | Path | TransporterSpec = "single_board",
    num_envs: int = 256,
    *,
    physics: PhysicsEngine = "batch",
    randomization: Randomization = "train",
    profile: str | Readings = "default",
    num_threads: int | None = None,
    pushes: bool = True,
    moving_start: float = 0.0,
    retry: float = 0.0,
    seed: int | None = None,
    dump_dir: str | Path | None = None,
    compiled: bool = False,
    rewards: Mapping[str, RewardTerm] = RIDING_REWARDS,
    history_length: int = 10,
    max_steps: int = 1000,
    stagger: int = 0,
    window: int = 250,
    grid: CommandGrid | None = None,
    runaway_margin: tuple[float, float] | None = None,
    stored_once: bool = False,
    **curriculum: Any,
) -> CurriculumEnv:
    """A :class:`RidingEnv` behind command curriculum, observation, history, time limit and episode reward.

    Args:
        robot: name of a registered robot, path of a ``.toml`` file that describes one, or a spec of your own.
        transporter: ``"single_board"`` or ``"two_board"`` in the robot's size, another registered name, path of a
            ``.toml`` file that describes one, or a spec.
        num_envs: N.
        physics: ``"batch"`` or ``"dm_control"``.
        randomization: ``"train"`` or ``"test"`` range of Table II, or ``"off"``.
        profile: name of a profile, or readings of your own.
        num_threads: physics threads; None for the CPUs this process may use.
        pushes: whether robot and platform are pushed every 3 s.
        moving_start: share of the episodes whose transporter starts at part of the commanded speeds (for training).
        retry: share of the falls after which the same robot tries again with its intrinsics (for training).
        seed: of env and curriculum alike, as ``env.set_seed`` sets both. Copies made with the same seed ride
            alike; those of a ``SerialEnv``, ``ParallelEnv`` or collector get different ones from its ``set_seed``.
        dump_dir: where the last half second of a simulation that failed is written; None for nowhere.
        compiled: see :class:`RidingEnv`.
        rewards: the terms of the reward by name.
        history_length: H, past observations that the estimators read.
        max_steps: control steps after which an episode is truncated (20 s at 50 Hz).
        stagger: if positive, the robots' first episodes end at different times, and the limit is looked at in every so
            many steps (for training): see :class:`~torchrl_atr.envs.transforms.StaggeredCounter`.
        window: control steps that a command lasts (5 s at 50 Hz).
        grid: the curriculum's cells and update rule; None for the paper's.
        runaway_margin: end episodes of transporters faster than any command by this much, m/s and rad/s (for training).
        stored_once: whether collected steps hold the history at the root alone, and reward terms in ``next`` alone (for
            training): see :class:`~torchrl_atr.envs.transforms.StoredOnce`.
        **curriculum: further arguments of :class:`~torchrl_atr.envs.transforms.CommandCurriculum`.

    Returns:
        The transformed env; ``env.curriculum`` is the curriculum.

    Raises:
        TypeError: for an argument that neither this function nor the curriculum has.
        ValueError: for a value that is impossible or of the wrong kind.

    Example:
        >>> env = make_riding_env(num_envs=2, seed=0)
        >>> env.rollout(2)["history"].shape
        torch.Size([2, 2, 10, 46])
    """
    _check_arguments(curriculum)
    env = RidingEnv(
        robot,
        transporter,
        num_envs,
        physics=physics,
        randomization=randomization,
        profile=profile,
        num_threads=num_threads,
        pushes=pushes,
        moving_start=moving_start,
        retry=retry,
        seed=seed,
        dump_dir=dump_dir,
        compiled=compiled,
        rewards=rewards,
    )
    transforms = riding_transforms(
        _tracking_max(env),
        history_length=history_length,
        include_current=env.readings.current_in_history,
        max_steps=max_steps,
        stagger=stagger,
        window=window,
        grid=grid,
        runaway_margin=runaway_margin,
        runaway_penalty=env.task.rewards.termination_cost,
        stored_once=stored_once,
        rest_key="speeds",
        seed=seed,
        **curriculum,
    )
    return CurriculumEnv(env, transforms)


def _tracking_max(env: RidingEnv) -> tuple[float, ...]:
    """Return what the tracking terms come to at no error; the curriculum's scores are shares of it."""
    for name, value in env.task.rewards.tracking_max.items():
        if not value > 0:
            raise RewardError(
                f"the command curriculum scores the reward term {name!r}, which needs a positive weight; or put the "
                "transforms of your choice around a RidingEnv"
            )
    return tuple(env.task.rewards.tracking_max.values())


def _check_arguments(curriculum: Mapping[str, Any]) -> None:
    ours, theirs = (inspect.signature(f).parameters for f in (make_riding_env, CommandCurriculum))
    for name in curriculum:
        if name not in theirs:
            raise TypeError(f"make_riding_env() has no argument {name!r}; {nearest(name, {**ours, **theirs})}")

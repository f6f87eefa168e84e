"""``make_env``: a task's env with the standard transforms, picklable through ``functools.partial``."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.envs import TransformedEnv

from torchrl_atr._checks import check_number
from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest
from torchrl_atr.envs.env import QuadrupedEnv
from torchrl_atr.envs.models import RobotSpec, TransporterSpec
from torchrl_atr.envs.physics import EngineName, Simulation
from torchrl_atr.envs.tasks import RewardError, Task, riding
from torchrl_atr.envs.tasks.intrinsic_parameters import Randomization
from torchrl_atr.envs.tasks.reconfiguration import Reconfigurable
from torchrl_atr.envs.tasks.riding.foot_steps import PLACE_COMPONENTS, FootSteps
from torchrl_atr.envs.transforms import (
    CommandCurriculum,
    CommandGrid,
    FootRepositioning,
    TimeLimitGrowth,
    task_transforms,
)


class CurriculumEnv(Reconfigurable, TransformedEnv):
    """Transformed env with a command curriculum at any position among its transforms."""

    @property
    def curriculum(self) -> CommandCurriculum:
        """Command curriculum, which also pins commands."""
        return next(transform for transform in self.transform if isinstance(transform, CommandCurriculum))


def make_env(
    task: Task,
    num_envs: int = 256,
    *,
    physics: EngineName | Simulation = "batch",
    randomization: Randomization = "train",
    num_threads: int | None = None,
    failed_episode_replay: float = 0.0,
    seed: int | None = None,
    dump_dir: str | Path | None = None,
    compiled: bool = False,
    history_length: int = 10,
    max_steps: int = 1000,
    stagger: int = 0,
    time_limit_growth: TimeLimitGrowth | None = None,
    window: int = 250,
    grid: CommandGrid | None = None,
    command_slew: tuple[float, float] | None = None,
    overspeed_margin: tuple[float, float] | None = None,
    reposition_feet: float = 0.0,
    compact_storage: bool = False,
    **curriculum: Any,
) -> CurriculumEnv:
    """Return a task's env behind command curriculum, observation, history, time limit and episode reward.

    Args:
        task: such as :func:`~torchrl_atr.envs.tasks.riding` or your own; its ``tracking_rewards`` are scored.
        num_envs: N.
        physics: see :class:`QuadrupedEnv`, as for ``randomization``, ``num_threads``, ``failed_episode_replay``,
            ``dump_dir`` and ``compiled``.
        randomization: ``"train"`` or ``"test"`` range, or ``"off"``.
        num_threads: of physics.
        failed_episode_replay: share of the failures after which the same robot tries again.
        dump_dir: where simulations that failed are written.
        compiled: whether ``torch.compile`` is used.
        seed: of env and curriculum alike, as ``env.set_seed`` sets both. Copies with the same seed behave alike; those
            of a ``SerialEnv``, ``ParallelEnv`` or collector get different ones from its ``set_seed``.
        history_length: H, past observations that the estimators read.
        max_steps: control steps after which an episode is truncated (20 s at 50 Hz).
        stagger: if positive, the robots' first episodes end at different times, and the limit is checked every
            ``stagger`` steps (for training): see :class:`~torchrl_atr.envs.transforms.RandomizedStepCounter`.
        time_limit_growth: lower time limit at first (for training, with ``stagger``): a
            :class:`~torchrl_atr.envs.transforms.TimeLimitGrowth`.
        window: control steps that a command lasts (5 s at 50 Hz).
        grid: the curriculum's cells and update rule; None for the task's.
        command_slew: largest change of the command per second, in its units; None for commands that jump.
        overspeed_margin: end episodes of robots faster than any command by this much, in the units of the command (for
            training).
        reposition_feet: distance from their places, in standing heights, at which two feet are stepped back, for
            policies that write ``("act", "extrinsic")``; 0 for no such steps. See
            :class:`~torchrl_atr.envs.tasks.riding.foot_steps.FootSteps`.
        compact_storage: whether collected steps hold the history at the root alone, and reward terms in ``next`` alone
            (for training): see :class:`~torchrl_atr.envs.transforms.CompactStorage`.
        **curriculum: further arguments of :class:`~torchrl_atr.envs.transforms.CommandCurriculum`.

    Returns:
        The transformed env; ``env.curriculum`` is the curriculum.

    Raises:
        TypeError: for an argument that neither this function nor the curriculum has.
        ValueError: for a value that is impossible or of the wrong kind.

    Example:
        >>> env = make_env(riding("a1", "two_board"), num_envs=2, seed=0)
        >>> env.rollout(2)["history"].shape
        torch.Size([2, 2, 10, 46])
    """
    _check_arguments(curriculum, make_env)
    _check_fixed(curriculum)
    env = QuadrupedEnv(
        task, num_envs, physics, randomization, num_threads, failed_episode_replay, seed, dump_dir, compiled
    )
    if grid is None and (grid := task.command.grid) is None:
        raise _unfit(task, "its command has no grid to be drawn from; give it one")
    if len(task.command) != 2:
        raise _unfit(task, f"its command has {len(task.command)} components, and a command curriculum draws two")
    if overspeed_margin is not None and "speeds" not in task.observations:
        raise _unfit(task, "it observes no 'speeds', which overspeed_margin needs; observe what answers the command")
    transforms = task_transforms(
        _tracking_max(env),
        history_length=history_length,
        include_current=task.interpretation.current_in_history,
        max_steps=max_steps,
        stagger=stagger,
        time_limit_growth=time_limit_growth,
        window=window,
        grid=grid,
        command_slew=command_slew,
        overspeed_margin=overspeed_margin,
        overspeed_penalty=env.runner.terms.rewards.termination_cost,
        foot_repositioning=_foot_repositioning(env, reposition_feet),
        compact_storage=compact_storage,
        unscored_key="moving_start",
        seed=seed,
        tracking_keys=[("reward_terms", name) for name in task.tracking_rewards],
        **curriculum,
    )
    return CurriculumEnv(env, transforms)


def make_riding_env(
    robot: str | Path | RobotSpec = "a1",
    transporter: str | Path | TransporterSpec = "single_board",
    num_envs: int = 256,
    **arguments: Any,
) -> CurriculumEnv:
    """Return ``make_env(riding(robot, transporter, ...), num_envs, ...)``.

    Args:
        robot: see :func:`~torchrl_atr.envs.tasks.riding`.
        transporter: likewise.
        num_envs: N.
        **arguments: further ones of :func:`~torchrl_atr.envs.tasks.riding`, of :func:`make_env` and of
            :class:`~torchrl_atr.envs.transforms.CommandCurriculum`.

    Raises:
        TypeError: for an argument that none of them has.

    Example:
        >>> env = make_riding_env(num_envs=2, seed=0, pushes=False)
        >>> env.rollout(2)["history"].shape
        torch.Size([2, 2, 10, 46])
    """
    of_the_task = inspect.signature(riding).parameters
    own = {name: arguments.pop(name) for name in list(arguments) if name in of_the_task}
    _check_arguments(arguments, make_riding_env, riding, make_env)
    return make_env(riding(robot, transporter, **own), num_envs, **arguments)


def _tracking_max(env: QuadrupedEnv) -> tuple[float, ...]:
    """Return what the tracking terms come to at no error; the curriculum's scores are shares of it."""
    task, tracking_max = env.task, env.runner.terms.rewards.tracking_max
    if len(tracking_max) != len(task.command):
        raise _unfit(
            task,
            f"tracking_rewards={tuple(task.tracking_rewards)}; name one reward term for each of "
            f"{', '.join(task.command.names)}, which the command curriculum scores",
            RewardError,
        )
    for name, value in tracking_max.items():
        if not value > 0:
            what = "has no positive weight" if name in task.rewards else "is not among its rewards"
            raise _unfit(task, f"the command curriculum scores the reward term {name!r}, which {what}", RewardError)
    return tuple(tracking_max.values())


def _foot_repositioning(env: QuadrupedEnv, share: float) -> FootRepositioning | None:
    """Return the transform that steps feet back at this share of the standing height; None for 0."""
    if not check_number("reposition_feet", share, low=0.0):
        return None
    sizes = env.runner.terms.observations.sizes
    extrinsic = sizes.get(("privileged", "extrinsic"), {})
    if not set(PLACE_COMPONENTS) <= set(extrinsic):
        raise _unfit(env.task, "reposition_feet needs the extrinsic state of riding, where feet have places on a board")
    threshold = share * env.task.robot.standing_height
    return FootRepositioning(FootSteps(env.scene, sizes["proprio"], extrinsic, threshold))


def _unfit(task: Task, problem: str, error: type[InputError] = InputError) -> InputError:
    alternative = "or put the transforms of your choice around a QuadrupedEnv"
    return error(f"task {task.name!r}: {problem}; {alternative}")


def _check_fixed(curriculum: Mapping[str, Any]) -> None:
    for name in ("tracking_max", "tracking_keys", "unscored_key"):
        if name in curriculum:
            raise TypeError(f"make_env() sets {name!r} of the curriculum itself, from the task; leave it out")


def _check_arguments(given: Mapping[str, Any], *functions: Any) -> None:
    known = {name for function in (*functions, CommandCurriculum) for name in inspect.signature(function).parameters}
    for name in given:
        if name not in known - {"arguments", "curriculum", "task"}:
            raise TypeError(f"{functions[0].__name__}() has no argument {name!r}; {nearest(name, sorted(known))}")

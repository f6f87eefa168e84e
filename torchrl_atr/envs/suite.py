"""Tasks as dm_control environments: ``load`` returns riding as a ``control.Environment``, ``load_task`` any task."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from torchrl_atr._checks import check_kind, check_number
from torchrl_atr.envs.models import build_scene
from torchrl_atr.envs.physics.dmc import DmControlEngine, EnginePhysics
from torchrl_atr.envs.physics.engine import DECIMATION
from torchrl_atr.envs.tasks import Task, riding
from torchrl_atr.envs.tasks.intrinsic_parameters import Randomization
from torchrl_atr.envs.tasks.runner import ACTION_LIMIT, EpisodeRunner
from torchrl_atr.envs.tasks.terms import Observed, StepOutcome

from dm_control.rl import control  # isort: skip  # after dmc, whose error names the package to install
from dm_env import specs  # isort: skip


def load(
    robot: Any = "a1",
    transporter: Any = "single_board",
    *,
    randomization: Randomization = "train",
    time_limit: float = 20.0,
    random: int | np.random.RandomState | None = None,
    **task: Any,
) -> control.Environment:
    """Return one robot riding one transporter, through dm_control's API.

    Args:
        robot: see :func:`~torchrl_atr.envs.tasks.riding`.
        transporter: likewise.
        randomization: ``"train"`` or ``"test"`` range of Table II, or ``"off"``.
        time_limit: s, after which the episode ends with discount 1.
        random: a seed or a random state, as elsewhere in dm_control.
        **task: further arguments of :func:`~torchrl_atr.envs.tasks.riding`, such as ``profile``, ``pushes`` or
            ``rewards``.

    Returns:
        The environment; set ``environment.task.command`` to command a speed and a yaw rate.

    Raises:
        UnknownNameError: for an unknown robot, transporter or profile.
        RobotError: for a robot that cannot ride as it is described.
        ValueError: for an unknown randomization.

    Example:
        >>> environment = load("a1", "single_board", random=0)
        >>> environment.task.command = (0.5, 0.0)
        >>> environment.reset().observation["command"].tolist()
        [0.5, 0.0]
    """
    return load_task(
        riding(robot, transporter, **task), randomization=randomization, time_limit=time_limit, random=random
    )


def load_task(
    task: Task,
    *,
    randomization: Randomization = "train",
    time_limit: float = 20.0,
    random: int | np.random.RandomState | None = None,
) -> control.Environment:
    """Return one robot at any task, through dm_control's API.

    Args:
        task: such as :func:`~torchrl_atr.envs.tasks.walking` or your own.
        randomization: see :func:`load`.
        time_limit: likewise.
        random: likewise.
    """
    check_kind("task", task, Task, "a Task, such as walking('a1')")
    check_number("time_limit", time_limit, above=0.0)
    engine = DmControlEngine(build_scene(task.robot, task.support), task.substep_hook)
    runner = EpisodeRunner(task, engine, randomization, torch.Generator())
    return control.Environment(engine.physics, SuiteTask(runner, random), time_limit=time_limit, n_sub_steps=DECIMATION)


class SuiteTask(control.Task):
    """dm_control task that forwards calls to the runner, which ``QuadrupedEnv`` uses too.

    Observations are flat arrays: ``proprio``, ``command``, ``observation`` (the two joined) and the task's other groups
    by their keys, nested ones joined, such as ``privileged_extrinsic`` (``privileged_...`` and ``speeds`` are not for a
    policy). Early termination has discount 0. Actions are bounded as those of ``QuadrupedEnv`` are; larger ones are
    applied up to the joints' control ranges.

    Args:
        runner: of a :class:`~torchrl_atr.envs.physics.dmc.DmControlEngine`.
        random: a seed or a random state.

    Attributes:
        reward_terms: the last step's weighted reward terms by name.
    """

    def __init__(self, runner: EpisodeRunner, random: int | np.random.RandomState | None = None) -> None:
        self.runner = runner
        self._random = random if isinstance(random, np.random.RandomState) else np.random.RandomState(random)
        self._command = torch.zeros(1, len(runner.task.command), dtype=torch.float32)
        self._first: Observed = runner.observe(self._command)  # dm_control reads its shapes before the first episode
        self._outcome: StepOutcome | None = None

    @property
    def command(self) -> NDArray[np.float32]:
        """Command in force, (C,), until it is set anew; zero at first. An observation holds that of its step."""
        return self._command[0].numpy().copy()

    @command.setter
    def command(self, value: ArrayLike) -> None:
        with np.errstate(over="ignore"):  # an overflow becomes an infinity, which is rejected
            command = torch.as_tensor(np.asarray(value, dtype=np.float32)).reshape(1, -1)
        if command.shape != self._command.shape or not torch.isfinite(command).all():
            names = self.runner.task.command.names
            raise ValueError(f"command={value!r}: give {len(names)} finite numbers, ({', '.join(names)})")
        self._command = command.clone()

    @property
    def reward_terms(self) -> dict[str, float]:
        """Weighted reward terms of the last step, see the class."""
        return {} if self._outcome is None else {name: float(value) for name, value in self._outcome.terms.items()}

    def initialize_episode(self, physics: EnginePhysics) -> None:
        """Draw fresh intrinsics and an initial state from this task's random state."""
        self.runner.rng.manual_seed(int(self._random.randint(2**31)))
        self._first = self.runner.start_episodes(torch.arange(1), self._command)
        self._outcome = None

    def before_step(self, action: ArrayLike, physics: EnginePhysics) -> None:
        """Apply disturbances that are due and the joint targets."""
        self.runner.apply_action(torch.as_tensor(np.array(action)).reshape(1, -1))

    def after_step(self, physics: EnginePhysics) -> None:
        """Compute rewards and terminations, once per control step."""
        self._outcome = self.runner.evaluate_step(self._command)
        self.runner.terminate_failed(self._outcome)

    def action_spec(self, physics: EnginePhysics) -> specs.BoundedArray:
        """Return bounds of joint displacements in units of the action scale: those of ``QuadrupedEnv``'s spec."""
        return specs.BoundedArray((self.runner.joints,), np.float64, -ACTION_LIMIT, ACTION_LIMIT, name="action")

    def get_observation(self, physics: EnginePhysics) -> dict[str, NDArray[np.float32]]:
        """Return the observations, one array per flat name."""
        observed = self._first if self._outcome is None else self._outcome.observed
        return {_flat(key): value[0].numpy().copy() for key, value in observed.items()}

    def get_reward(self, physics: EnginePhysics) -> float:
        """Return the sum of all terms."""
        assert self._outcome is not None  # dm_control calls this after a step
        return float(self._outcome.reward)

    def get_termination(self, physics: EnginePhysics) -> float | None:
        """Return discount 0 if the episode ended early, else None."""
        return 0.0 if self._outcome is not None and bool(self._outcome.terminated) else None


def _flat(key: Any) -> str:
    return key if isinstance(key, str) else "_".join(key)

"""The riding task in dm_control's own terms: ``load`` gives an ordinary ``control.Environment``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from torchrl_atr._checks import check_number
from torchrl_atr.envs.models import RobotSpec, TransporterSpec, build_scene, get_robot, get_transporter
from torchrl_atr.envs.physics.dmc import DmControlEngine, RidingPhysics
from torchrl_atr.envs.physics.engine import DECIMATION
from torchrl_atr.envs.profiles import Readings, get_readings
from torchrl_atr.envs.task.core import ACTION_LIMIT, COMMAND_FEATURES, Outcome, RidingTask
from torchrl_atr.envs.task.randomization import Randomization
from torchrl_atr.envs.task.reward_terms import RewardTerm
from torchrl_atr.envs.task.rewards import RIDING_REWARDS

from dm_control.rl import control  # isort: skip  # after dmc, which says what to install
from dm_env import specs  # isort: skip


def load(
    robot: str | Path | RobotSpec = "a1",
    transporter: str | Path | TransporterSpec = "single_board",
    *,
    profile: str | Readings = "default",
    randomization: Randomization = "train",
    time_limit: float = 20.0,
    pushes: bool = True,
    rewards: Mapping[str, RewardTerm] = RIDING_REWARDS,
    random: int | np.random.RandomState | None = None,
) -> control.Environment:
    """One robot riding one transporter, through dm_control's API.

    Args:
        robot: name of a registered robot, path of a ``.toml`` file that describes one, or a spec of your own.
        transporter: ``"single_board"`` or ``"two_board"`` in the robot's size, another registered name, path of a
            ``.toml`` file that describes one, or a spec.
        profile: name of a profile, or readings of your own.
        randomization: ``"train"`` or ``"test"`` range of Table II, or ``"off"``.
        time_limit: s, after which the episode ends with discount 1.
        pushes: whether robot and platform are pushed every 3 s.
        rewards: the terms of the reward by name.
        random: a seed or a random state, as elsewhere in dm_control.

    Returns:
        The environment; set ``environment.task.command`` to ask for a speed and a yaw rate.

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
    check_number("time_limit", time_limit, above=0.0)
    readings = get_readings(profile)
    rider = get_robot(robot)
    scene = build_scene(rider, get_transporter(transporter, rider), readings)
    engine = DmControlEngine(scene, readings)
    core = RidingTask(engine, readings, randomization, pushes, torch.Generator(), rewards=rewards)
    task = SuiteTask(core, random)
    return control.Environment(engine.physics, task, time_limit=time_limit, n_sub_steps=DECIMATION)


class SuiteTask(control.Task):
    """Hands dm_control's calls on to the one task that ``RidingEnv`` drives as well.

    Observations are flat float32 arrays: ``proprio``, ``command``, ``observation`` (the two joined), ``odometry``;
    and, not for a policy, ``speeds``, ``privileged_intrinsic``, ``privileged_extrinsic`` and ``privileged_outlook``.
    Early termination has discount 0. Actions are bounded as those of ``RidingEnv`` are; larger ones are carried out up
    to the joints' control ranges.

    Args:
        core: the task over a :class:`~torchrl_atr.envs.physics.dmc.DmControlEngine`.
        random: a seed or a random state.

    Attributes:
        reward_terms: the last step's weighted reward terms by name.
    """

    def __init__(self, core: RidingTask, random: int | np.random.RandomState | None = None) -> None:
        self.core = core
        self._random = random if isinstance(random, np.random.RandomState) else np.random.RandomState(random)
        self._command = torch.zeros(1, len(COMMAND_FEATURES), dtype=torch.float32)
        self._outcome: Outcome | None = None

    @property
    def command(self) -> NDArray[np.float32]:
        """(c_v, c_ω), m/s and rad/s, until it is set anew; zero at first. An observation holds that of its step."""
        return self._command[0].numpy().copy()

    @command.setter
    def command(self, value: ArrayLike) -> None:
        with np.errstate(over="ignore"):  # it becomes an infinity, which is refused
            command = torch.as_tensor(np.asarray(value, dtype=np.float32)).reshape(1, -1)
        if command.shape != self._command.shape or not torch.isfinite(command).all():
            names = ", ".join(COMMAND_FEATURES)
            raise ValueError(f"command={value!r}: give {len(COMMAND_FEATURES)} finite numbers, ({names})")
        self._command = command.clone()

    @property
    def reward_terms(self) -> dict[str, float]:
        """See the class."""
        return {} if self._outcome is None else {name: float(value) for name, value in self._outcome.terms.items()}

    def initialize_episode(self, physics: RidingPhysics) -> None:
        """Fresh intrinsics and initial state, drawn from this task's random state."""
        self.core.rng.manual_seed(int(self._random.randint(2**31)))
        self.core.begin(np.arange(1))
        self._outcome = None

    def before_step(self, action: ArrayLike, physics: RidingPhysics) -> None:
        """Pushes that are due and the joint targets."""
        self.core.act(torch.as_tensor(np.array(action)).reshape(1, -1))

    def after_step(self, physics: RidingPhysics) -> None:
        """Rewards and terminations, once per control step."""
        self._outcome = self.core.judge(self._command)

    def action_spec(self, physics: RidingPhysics) -> specs.BoundedArray:
        """Joint displacements in units of the action scale, in the range of ``RidingEnv``'s spec."""
        return specs.BoundedArray((self.core.joints,), np.float64, -ACTION_LIMIT, ACTION_LIMIT, name="action")

    def get_observation(self, physics: RidingPhysics) -> dict[str, NDArray[np.float32]]:
        """Flat names, one array each."""
        observed = self.core.observe(self._command) if self._outcome is None else self._outcome.observed
        return {_flat(key): value[0].numpy().copy() for key, value in observed.items()}

    def get_reward(self, physics: RidingPhysics) -> float:
        """The sum of all terms."""
        assert self._outcome is not None  # dm_control asks after a step
        return float(self._outcome.reward)

    def get_termination(self, physics: RidingPhysics) -> float | None:
        """Discount 0 if the episode ended early, else None."""
        return 0.0 if self._outcome is not None and bool(self._outcome.terminated) else None


def _flat(key: Any) -> str:
    return key if isinstance(key, str) else "_".join(key)

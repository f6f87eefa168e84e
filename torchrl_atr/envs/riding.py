"""``RidingEnv``: the riding task as an env."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torchrl_atr.envs.env import QuadrupedEnv
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models import RobotSpec, TransporterSpec
from torchrl_atr.envs.physics import EngineName, Simulation
from torchrl_atr.envs.tasks import riding
from torchrl_atr.envs.tasks.intrinsic_parameters import Randomization


class RidingEnv(QuadrupedEnv):
    """Quadrupeds riding tilt-driven transporters: ``QuadrupedEnv(riding(robot, transporter, ...), ...)``.

    Args:
        robot, transporter, profile: see :func:`~torchrl_atr.envs.tasks.riding`.
        num_envs, physics, randomization, num_threads, failed_episode_replay, seed, dump_dir, compiled: see
            :class:`~torchrl_atr.envs.QuadrupedEnv`.
        **of_the_task: further arguments of :func:`~torchrl_atr.envs.tasks.riding`, such as ``sensors="realistic"``.

    Raises:
        UnknownNameError: for an unknown robot, transporter or profile.
        RobotError, ValueError, KeyError, TypeError: see :class:`~torchrl_atr.envs.QuadrupedEnv` and
            :func:`~torchrl_atr.envs.tasks.riding`.

    Example:
        >>> env = RidingEnv(num_envs=4, seed=0)
        >>> env.rollout(3)["next", "observation"].shape
        torch.Size([4, 3, 46])
    """

    def __init__(
        self,
        robot: str | Path | RobotSpec = "a1",
        transporter: str | Path | TransporterSpec = "single_board",
        num_envs: int = 256,
        physics: EngineName | Simulation = "batch",
        randomization: Randomization = "train",
        profile: str | Interpretation = "default",
        num_threads: int | None = None,
        failed_episode_replay: float = 0.0,
        seed: int | None = None,
        dump_dir: str | Path | None = None,
        compiled: bool = False,
        **of_the_task: Any,
    ) -> None:
        task = riding(robot, transporter, profile=profile, **of_the_task)
        super().__init__(
            task, num_envs, physics, randomization, num_threads, failed_episode_replay, seed, dump_dir, compiled
        )

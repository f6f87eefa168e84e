"""Initial states, disturbances and terminations of episodes, as data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchrl_atr._checks import check_flag, check_number
from torchrl_atr._errors import InputError
from torchrl_atr._settings import Settings, setting
from torchrl_atr.envs.models.scene import STAND, Scene, columns
from torchrl_atr.envs.physics.engine import CONTROL_DT, Engine
from torchrl_atr.envs.tasks.context import StepContext

HEIGHT_SPREAD = 0.02
"""Largest initial height above the standing pose, m."""
JOINT_SPREAD = 0.05
"""Largest initial deviation of a joint angle from q0, rad."""
Termination = Callable[[StepContext], Tensor]
"""Function of a context that returns the episodes to end early, (N,) bool; ``terminated`` is not set yet."""


class InitialState(NamedTuple):
    """Initial states of n episodes.

    Attributes:
        qpos: (n, nq), float64.
        qvel: (n, nv), float64.
        moving: which of them start with part of the commanded speeds, (n,) bool: a curriculum does not score their
            first window, which shows no skill.
    """

    qpos: Tensor
    qvel: Tensor
    moving: Tensor


Reset = Callable[[Scene, Tensor, torch.Generator], InitialState]
"""Function of scene, commands (n, C) and a generator that returns the initial states of n episodes."""


@dataclass(frozen=True)
class Disturbance:
    """Periodic disturbance of robots.

    Attributes:
        function: ``function(engine, rows, generator)`` changes the live state of ``rows``, (n,) integers.
        interval: time between two of them, s, counted from the start of an episode.
        is_push: whether ``reconfigure(pushes=...)`` switches it off or changes its sizes; the function of a push also
            takes a keyword argument ``pushes``, a :class:`Pushes`.

    Raises:
        InputError: if the function cannot be called, the interval is not at least a control step, or ``is_push`` is no
            bool.

    Example:
        >>> Disturbance(push_robot, interval=3.0, is_push=True).steps
        150
    """

    function: Callable[..., None]
    interval: float
    is_push: bool = False

    def __post_init__(self) -> None:
        check_flag("is_push", self.is_push)
        if not callable(self.function):
            raise InputError(f"function={self.function!r} of a disturbance cannot be called; give a function")
        check_number("interval", self.interval, CONTROL_DT)

    @property
    def steps(self) -> int:
        """Control steps between two disturbances."""
        return round(self.interval / CONTROL_DT)


@dataclass(frozen=True)
class Pushes(Settings):
    """Sizes and interval of the pushes of robot and transporter (A33); each push is uniform up to its size.

    Example:
        >>> Pushes(interval=4.0, robot=1.0).yaw_rate
        0.25
    """

    group = "task.pushes"

    interval: float = setting(3.0, within=(0, 1e6), unit="s")
    """Time between two pushes; 0 for none. Four of five falls come within a second of a push."""
    robot: float = setting(0.5, within=(0, 100), unit="m/s")
    """Largest change of the robot's velocity along x and y."""
    speed: float = setting(0.5, within=(0, 100), unit="m/s")
    """Largest change of the transporter's forward speed."""
    yaw_rate: float = setting(0.25, within=(0, 100), unit="rad/s")
    """Largest change of its yaw rate."""

    @staticmethod
    def of(pushes: Pushes | bool) -> Pushes | None:
        """Return the pushes for a task's argument ``pushes``: the defaults for True, None for no pushes.

        Raises:
            InputError: for a value of another kind.
        """
        if not isinstance(pushes, Pushes):
            pushes = Pushes() if check_flag("pushes", pushes) else Pushes(interval=0.0)
        return pushes if pushes.interval > 0 else None


def uniform(n: int, columns: int, generator: torch.Generator) -> Tensor:
    """Return n draws from [-1, 1), (n, columns) float64."""
    return torch.rand(n, columns, generator=generator, dtype=torch.float64).mul(2.0).sub(1.0)


def push_robot(engine: Engine, rows: Tensor, generator: torch.Generator, pushes: Pushes = Pushes()) -> None:
    """Change the robots' horizontal velocity along x and y."""
    root = engine.scene.layout.root_dof
    engine.qvel[rows, root : root + 2] += pushes.robot * uniform(len(rows), 2, generator)


def stand(scene: Scene, command: Tensor, generator: torch.Generator) -> InitialState:
    """Return n standing poses at rest, with slightly randomised height and joint angles; ``command`` is unused."""
    n, key = len(command), scene.model.key(STAND)
    joints, root = scene.layout.joint_qpos, scene.layout.root_qpos
    draw = torch.rand(n, 1 + len(joints), generator=generator, dtype=torch.float64)
    qpos = torch.from_numpy(key.qpos).expand(n, -1).clone()
    qpos[:, root + 2].add_(draw[:, 0], alpha=HEIGHT_SPREAD)
    qpos[:, columns(joints)] += JOINT_SPREAD * (2.0 * draw[:, 1:] - 1.0)
    qvel = torch.zeros(n, scene.model.nv, dtype=torch.float64)
    return InitialState(qpos, qvel, torch.zeros(n, dtype=torch.bool))


def tilted(c: StepContext) -> Tensor:
    """Return whether body roll or pitch is beyond the limit (A34), (N,)."""
    return (c.state.euler[:, :2].abs() > c.interpretation.tilt_limit).any(-1)


def too_low(c: StepContext) -> Tensor:
    """Return whether the body is too low over the support, (N,)."""
    return c.state.position[:, 2] - c.scene.support.height < c.robot.min_height

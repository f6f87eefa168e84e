"""How episodes begin and end, and what happens to robots in between, as data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchrl_atr._checks import check_number
from torchrl_atr._errors import InputError
from torchrl_atr.envs.models.scene import STAND, Scene, columns
from torchrl_atr.envs.physics.engine import CONTROL_DT, Engine
from torchrl_atr.envs.tasks.context import StepContext

HEIGHT_SPREAD = 0.02
"""How far above the stand robots start at most, m."""
JOINT_SPREAD = 0.05
"""How far from q0 joints start at most, rad."""
ROBOT_PUSH = 0.5
"""Largest change of the robot's velocity along x and y, m/s (A33)."""
PUSH_INTERVAL = 3.0
"""Seconds between pushes."""
Termination = Callable[[StepContext], Tensor]
"""Which robots' episodes end early, (N,) bool; the context's ``terminated`` says nothing yet."""


class InitialState(NamedTuple):
    """How n episodes start.

    Attributes:
        qpos: (n, nq), float64.
        qvel: (n, nv), float64.
        moving: which of them start with part of what is commanded, (n,) bool: their first seconds show no skill, and a
            curriculum does not score them.
    """

    qpos: Tensor
    qvel: Tensor
    moving: Tensor


Reset = Callable[[Scene, Tensor, torch.Generator], InitialState]
"""From scene, commands (n, C) and a source of randomness to how n episodes start."""


@dataclass(frozen=True)
class Disturbance:
    """What happens to robots again and again.

    Attributes:
        function: ``function(engine, rows, generator)`` changes the live state of ``rows``, (n,) integers.
        interval: s between two of them, counted from the start of an episode.

    Raises:
        InputError: if the function cannot be called, or the interval is not at least a control step.

    Example:
        >>> Disturbance(push_robot, interval=3.0).steps
        150
    """

    function: Callable[[Engine, Tensor, torch.Generator], None]
    interval: float

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise InputError(f"function={self.function!r} of a disturbance cannot be called; give a function")
        check_number("interval", self.interval, CONTROL_DT)

    @property
    def steps(self) -> int:
        """Control steps between two of them."""
        return round(self.interval / CONTROL_DT)


def uniform(n: int, columns: int, generator: torch.Generator) -> Tensor:
    """Return n draws from [-1, 1), (n, columns) float64."""
    return torch.rand(n, columns, generator=generator, dtype=torch.float64).mul(2.0).sub(1.0)


def push_robot(engine: Engine, rows: Tensor, generator: torch.Generator) -> None:
    """Change the robots' horizontal velocity by up to :data:`ROBOT_PUSH` along x and y."""
    root = engine.scene.layout.root_dof
    engine.qvel[rows, root : root + 2] += ROBOT_PUSH * uniform(len(rows), 2, generator)


def stand(scene: Scene, command: Tensor, generator: torch.Generator) -> InitialState:
    """Start in the standing pose with slightly randomised height and joint angles, at rest.

    Args:
        scene: its keyframe ``stand`` is the standing pose.
        command: (n, C); not read.
        generator: source of randomness.
    """
    n, key = len(command), scene.model.key(STAND)
    joints, root = scene.layout.joint_qpos, scene.layout.root_qpos
    draw = torch.rand(n, 1 + len(joints), generator=generator, dtype=torch.float64)
    qpos = torch.from_numpy(key.qpos).expand(n, -1).clone()
    qpos[:, root + 2].add_(draw[:, 0], alpha=HEIGHT_SPREAD)
    qpos[:, columns(joints)] += JOINT_SPREAD * (2.0 * draw[:, 1:] - 1.0)
    qvel = torch.zeros(n, scene.model.nv, dtype=torch.float64)
    return InitialState(qpos, qvel, torch.zeros(n, dtype=torch.bool))


def tilted(c: StepContext) -> Tensor:
    """Body roll or pitch beyond the limit (A34), (N,)."""
    return (c.state.euler[:, :2].abs() > c.readings.tilt_limit).any(-1)


def too_low(c: StepContext) -> Tensor:
    """Body too low over the support, (N,)."""
    return c.state.position[:, 2] - c.scene.support.height < c.robot.min_height

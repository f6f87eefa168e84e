"""Initial states, pushes and terminations of riding (A33, A34)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import torch
from torch import Tensor

from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.events import (
    InitialState,
    Pushes,
    Reset,
    Termination,
    stand,
    tilted,
    too_low,
    uniform,
)

DISPLACEMENT = (0.1, 0.06)
"""Largest initial displacement of a robot along x and y from the middle of the boards, m."""
TURN = 0.2
"""Largest initial yaw of a displaced robot, rad."""


def push(engine: Engine, rows: Tensor, generator: torch.Generator, pushes: Pushes = Pushes()) -> None:
    """Push ``rows``: the robot in the plane, the transporter through the drive law's state.

    Args:
        engine: whose ``qvel`` and hook's ``speeds`` change.
        rows: (n,) integers.
        generator: source of randomness.
        pushes: their sizes.
    """
    draw = uniform(len(rows), 4, generator)
    root = engine.scene.layout.root_dof
    engine.qvel[rows, root : root + 2] += pushes.robot * draw[:, :2]
    engine.hook.state["speeds"][rows] += (
        torch.tensor([pushes.speed, pushes.yaw_rate], dtype=torch.float64) * draw[:, 2:]
    )


def start(moving: float = 0.0, displaced: float = 0.0) -> Reset:
    """Return the reset function: standing at rest in the middle, but for two shares of the starts, for training.

    Args:
        moving: share of all starts that are on the move, in [0, 1].
        displaced: share of all starts with the robot shifted and turned on the boards, in [0, 1]; drawn independently.
    """
    return partial(_start, moving, displaced) if moving > 0.0 or displaced > 0.0 else stand


def _start(moving: float, displaced: float, scene: Scene, command: Tensor, generator: torch.Generator) -> InitialState:
    """Start in the standing pose, not moving relative to the transporter.

    The transporter may move at part of the command: tracking kernels are steepest near their peak, and the yaw rate
    follows a lean by seconds. A robot that starts at (part of) the commanded yaw rate is rewarded at once for a lean
    that keeps it; one that starts at rest has the costs of the lean long before it turns. Each component of a moving
    start is uniform between 0 and its command. A displaced robot stands up to :data:`DISPLACEMENT` from the middle and
    turned by up to :data:`TURN`, as after a minute of pushes, and must step back.
    """
    n = len(command)
    draw = torch.rand(n, 4, generator=generator, dtype=torch.float64)
    speeds = torch.where(draw[:, :1] < moving, draw[:, 1:3] * command.double(), 0.0)
    qpos, qvel, _ = stand(scene, command, generator)
    place = uniform(n, 3, generator).where(draw[:, 3:] < displaced, 0.0)
    _displace(scene, qpos, place * torch.tensor([*DISPLACEMENT, TURN], dtype=torch.float64))
    (forward, _, yaw), root = scene.support_layout.planar_dof, scene.layout.root_dof
    qvel[:, forward], qvel[:, yaw] = speeds[:, 0], speeds[:, 1]
    # the robot moves with the board as one rigid body: v + omega x r
    offset = qpos[:, scene.layout.root_qpos : scene.layout.root_qpos + 2]
    qvel[:, root] = speeds[:, 0] - speeds[:, 1] * offset[:, 1]
    qvel[:, root + 1] = speeds[:, 1] * offset[:, 0]
    qvel[:, root + 5] = speeds[:, 1]
    return InitialState(qpos, qvel, (speeds != 0.0).any(-1))


def _displace(scene: Scene, qpos: Tensor, place: Tensor) -> None:
    """Shift and turn robots, ``qpos`` (n, nq), about the middle of the boards by x, y (m) and yaw (rad), (n, 3)."""
    x, half = scene.layout.root_qpos, place[:, 2] / 2
    cosine, sine = torch.cos(place[:, 2]), torch.sin(place[:, 2])
    ahead, left = qpos[:, x].clone(), qpos[:, x + 1].clone()
    qpos[:, x] = cosine * ahead - sine * left + place[:, 0]
    qpos[:, x + 1] = sine * ahead + cosine * left + place[:, 1]
    w, i, j, k = qpos[:, x + 3 : x + 7].clone().unbind(-1)
    c, s = torch.cos(half), torch.sin(half)
    qpos[:, x + 3 : x + 7] = torch.stack([c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w], -1)


def off_the_boards(c: StepContext) -> Tensor:
    """Return whether the body's centre is beyond the boards, (N,)."""
    length, width = c.scene.support.size
    return (c.state.relative_position.abs() > c.action.new_tensor([length / 2, width / 2])).any(-1)


TERMINATIONS: Mapping[str, Termination] = {"tilted": tilted, "off_the_boards": off_the_boards, "too_low": too_low}
"""Early terminations (A34): the robot risks flipping, or falling off or onto the transporter."""

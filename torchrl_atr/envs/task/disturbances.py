"""Pushes (every 3 s, on the robot and on the platform) and the randomised initial state."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from torchrl_atr.envs.models.scene import STAND, Scene
from torchrl_atr.envs.physics.engine import Array, Engine

PUSH_INTERVAL = 3.0
"""Seconds between pushes."""
ROBOT_PUSH = 0.5
"""Largest change of the robot's velocity along x and y, m/s (A33)."""
PLATFORM_PUSH = (0.5, 0.25)
"""Largest change of the platform's forward speed (m/s) and yaw rate (rad/s) (A33)."""
_HEIGHT_SPREAD = 0.02
_JOINT_SPREAD = 0.05


def push(engine: Engine, rows: NDArray[np.int64], generator: torch.Generator) -> None:
    """Kicks ``rows``: the robot in the plane, the platform through the drive law's state.

    Args:
        engine: whose ``qvel`` and ``speeds`` change.
        rows: (n,) integers.
        generator: source of randomness.
    """
    draw = torch.rand(len(rows), 4, generator=generator, dtype=torch.float64).mul(2.0).sub(1.0).numpy()
    root = engine.scene.layout.root_dof
    engine.qvel[rows, root : root + 2] += ROBOT_PUSH * draw[:, :2]
    engine.speeds[rows] += np.array(PLATFORM_PUSH) * draw[:, 2:]


def initial_speeds(commands: Array, moving_start: float, generator: torch.Generator) -> Array:
    """Speeds that transporters start with: a random part of what is commanded, or rest.

    The tracking kernels are steepest near their peak, and the yaw that a lean earns comes seconds later: a rider that
    starts at (part of) the commanded yaw rate feels at once that leaning keeps it, one that starts at rest pays for the
    lean long before it turns.

    Args:
        commands: (c_v, c_ω), (n, 2).
        moving_start: share of the starts that are on the move, in [0, 1].
        generator: source of randomness.

    Returns:
        (n, 2): each component of a moving start is uniform between 0 and its command.
    """
    draw = torch.rand(len(commands), 3, generator=generator, dtype=torch.float64).numpy()
    return np.where(draw[:, :1] < moving_start, draw[:, 1:] * commands, 0.0)


def initial_state(scene: Scene, n: int, generator: torch.Generator, speeds: Array | None = None) -> tuple[Array, Array]:
    """The standing pose with slightly randomised height and joint angles, not moving relative to its transporter.

    Args:
        scene: its keyframe ``stand`` is the standing pose.
        n: how many robots.
        generator: source of randomness.
        speeds: forward speed and yaw rate of the transporters, heading along x, (n, 2); None for rest.

    Returns:
        ``qpos`` (n, nq) and ``qvel`` (n, nv); up to 2 cm above the stand, joints within 0.05 rad of q0.
    """
    model, layout = scene.model, scene.layout
    joints = len(layout.joint_qpos)
    draw = torch.rand(n, 1 + joints, generator=generator, dtype=torch.float64).numpy()
    qpos = np.tile(model.key(STAND).qpos, (n, 1))
    qpos[:, layout.root_qpos + 2] += _HEIGHT_SPREAD * draw[:, 0]
    qpos[:, layout.joint_qpos] += _JOINT_SPREAD * (2.0 * draw[:, 1:] - 1.0)
    qvel = np.zeros((n, model.nv))
    if speeds is not None:
        planar, root = layout.planar_dof, layout.root_dof
        qvel[:, planar[0]], qvel[:, planar[2]] = speeds[:, 0], speeds[:, 1]
        # the robot moves with the board as one rigid body: v + omega x r
        offset = qpos[:, layout.root_qpos : layout.root_qpos + 2]
        qvel[:, root] = speeds[:, 0] - speeds[:, 1] * offset[:, 1]
        qvel[:, root + 1] = speeds[:, 1] * offset[:, 0]
        qvel[:, root + 5] = speeds[:, 1]
    return qpos, qvel

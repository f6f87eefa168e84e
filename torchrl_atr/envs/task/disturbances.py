"""Pushes (every 3 s, on the robot and on the platform) and the randomised initial state."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from torchrl_atr.envs.models.scene import Scene
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


def initial_state(scene: Scene, n: int, generator: torch.Generator) -> tuple[Array, Array]:
    """The standing pose with slightly randomised height and joint angles, at rest.

    Args:
        scene: keyframe 0 is the standing pose.
        n: how many robots.
        generator: source of randomness.

    Returns:
        ``qpos`` (n, nq) and ``qvel`` (n, nv); up to 2 cm above the stand, joints within 0.05 rad of q0.
    """
    model, layout = scene.model, scene.layout
    joints = len(layout.joint_qpos)
    draw = torch.rand(n, 1 + joints, generator=generator, dtype=torch.float64).numpy()
    qpos = np.tile(model.key_qpos[0], (n, 1))
    qpos[:, layout.root_qpos + 2] += _HEIGHT_SPREAD * draw[:, 0]
    qpos[:, layout.joint_qpos] += _JOINT_SPREAD * (2.0 * draw[:, 1:] - 1.0)
    return qpos, np.zeros((n, model.nv))

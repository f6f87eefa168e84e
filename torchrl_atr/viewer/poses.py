"""World poses of all bodies of an env's robots, and the frame of a picture that follows one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from torchrl.envs import EnvBase

from torchrl_atr.envs.access import base_env

Array = NDArray[np.float64]
SPACING = 1.6
"""Distance between the lanes of several robots, m."""
_TURNING_TIME = 1.0  # s


@dataclass(frozen=True)
class Poses:
    """Poses of N robots' B bodies in the world.

    Attributes:
        positions: m, (N, B, 3); every robot has its own lane, :data:`SPACING` to the right of the one before.
        rotations: (N, B, 3, 3).
        places: x and y of the body that cameras follow, m, (N, 2).
        headings: of that body, rad, (N,).
    """

    positions: Array
    rotations: Array
    places: Array
    headings: Array


class PoseReader:
    """Reader of body poses from the engine's configuration, at their places in the world.

    Args:
        env: a QuadrupedEnv, transformed or not.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> poses = PoseReader(make_riding_env(num_envs=2, seed=0)).read()
        >>> poses.positions.shape == (2, 15, 3), (poses.places[1] - poses.places[0]).tolist()
        (True, [0.0, -1.6])
    """

    def __init__(self, env: EnvBase) -> None:
        self._engine = base_env(env).engine
        self.model: mujoco.MjModel = self._engine.scene.model
        self._data = mujoco.MjData(self.model)
        self._followed = self._engine.scene.layout.followed_body

    def read(self) -> Poses:
        """Return the present poses."""
        n, bodies = self._engine.num_envs, self.model.nbody
        positions, rotations = np.empty((n, bodies, 3)), np.empty((n, bodies, 3, 3))
        for row, qpos in enumerate(self._engine.qpos.numpy()):
            self._data.qpos[:] = qpos
            mujoco.mj_kinematics(self.model, self._data)
            positions[row], rotations[row] = self._data.xpos, self._data.xmat.reshape(-1, 3, 3)
        positions[:, 1:, :2] += self._engine.world_offset.numpy()[:, None]  # body 0 is the world
        positions[:, 1:, 1] -= SPACING * np.arange(n)[:, None]
        followed = rotations[:, self._followed]
        headings = np.arctan2(followed[:, 1, 0], followed[:, 0, 0])
        return Poses(positions, rotations, positions[:, self._followed, :2].copy(), headings)


class ChaseFrame:
    """Frame that moves with a robot and turns after it with a lag, so that turning is visible.

    Attributes:
        place: its origin in the world, m, (2,).
        yaw: its heading in the world, rad.

    Example:
        >>> frame = ChaseFrame()
        >>> frame.follow(np.array([3.0, 0.0]), math.pi / 2, dt=0.02)
        >>> frame.to_frame(np.array([[3.0, 1.0, 0.5]])).round(6).tolist()
        [[1.0, 0.0, 0.5]]
    """

    def __init__(self) -> None:
        self.place = np.zeros(2)
        self.yaw: float | None = None

    def follow(self, place: Array, heading: float, dt: float) -> None:
        """Move to a robot's place, and turn towards its heading.

        Args:
            place: m, (2,).
            heading: rad.
            dt: seconds since the last call.
        """
        self.place = place
        if self.yaw is None:
            self.yaw = heading
        else:
            self.yaw += math.remainder(heading - self.yaw, math.tau) * min(1.0, dt / _TURNING_TIME)

    @property
    def rotation(self) -> Array:
        """Rotation from the world into the frame, (3, 3)."""
        cosine, sine = math.cos(self.yaw or 0.0), math.sin(self.yaw or 0.0)
        return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])

    def to_frame(self, positions: Array) -> Array:
        """Return world positions, m, (*B, 3), in the frame."""
        shifted = positions.copy()
        shifted[..., :2] -= self.place
        return shifted @ self.rotation.T

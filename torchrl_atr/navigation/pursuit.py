"""Pure pursuit: the command (c_v, c_ω) that follows a path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchrl_atr._checks import check_number
from torchrl_atr._errors import InputError
from torchrl_atr.navigation.paths import STEP, Path

Array = NDArray[np.float64]
SEARCH = 2.0
"""Distance ahead of the last nearest point in which the next one is looked for, m: where a path crosses itself, another
branch is nearer."""


@dataclass(frozen=True)
class PursuitConfig:
    """Parameters of pure pursuit.

    Attributes:
        speed: cruising speed, m/s.
        max_yaw_rate: largest |c_ω|, rad/s.
        look_ahead: seconds of travel that the pursued point is ahead, s.
        min_look_ahead: least distance to that point, m.
        deceleration: with which the speed falls before the goal, m/s².
        goal_radius: distance at which the goal is reached, m.

    Raises:
        InputError: for a number that is not positive.

    Example:
        >>> PursuitConfig(speed=3.0).look_ahead
        1.0
    """

    speed: float = 1.5
    max_yaw_rate: float = 1.0
    look_ahead: float = 1.0
    min_look_ahead: float = 1.0
    deceleration: float = 0.5
    goal_radius: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_number(name, value, above=0.0)


class PurePursuit:
    """Pure pursuit of n paths by n robots at once.

    The curvature of the arc to the pursued point at distance L and lateral offset y is κ = 2 y / L²; the commands are
    c_v, which falls before the goal and where κ c_v would exceed the largest yaw rate, and c_ω = κ c_v.

    Args:
        paths: one for each robot.
        config: parameters; by default 1.5 m/s.

    Attributes:
        progress: index of the nearest point of each path, (n,).
        distance: distance to it when it was last located, m, (n,).

    Raises:
        InputError: without a path.

    Example:
        >>> path = Path.through(np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [6.0, 0.0]]))
        >>> PurePursuit([path], PursuitConfig()).command(np.array([[0.0, 0.0, 0.0]])).round(3).tolist()
        [[1.5, 0.0]]
    """

    def __init__(self, paths: Sequence[Path], config: PursuitConfig | None = None) -> None:
        if not paths:
            raise InputError("pure pursuit needs a path for each robot; got none")
        self.config = config or PursuitConfig()
        self._last = np.array([len(path.points) - 1 for path in paths])
        longest = int(self._last.max()) + 1
        self._points = np.stack([np.pad(p.points, ((0, longest - len(p.points)), (0, 0)), mode="edge") for p in paths])
        self.progress, self.distance = np.zeros(len(paths), dtype=int), np.zeros(len(paths))

    @property
    def goals(self) -> Array:
        """Ends of the paths, (n, 2)."""
        return self._at(self._last)

    def _at(self, index: NDArray[np.int64]) -> Array:
        return self._points[np.arange(len(index)), index]

    def locate(self, poses: Array) -> Array:
        """Advance :attr:`progress` to the nearest points ahead, and return the distances to them, m, (n,)."""
        window = np.arange(round(SEARCH / STEP) + 1)
        index = np.minimum(self.progress[:, None] + window, self._last[:, None])
        near = np.take_along_axis(self._points, index[..., None], 1)
        distance = np.linalg.norm(near - poses[:, None, :2], axis=-1)
        best = distance.argmin(-1)
        self.progress = index[np.arange(len(best)), best]
        self.distance = distance[np.arange(len(best)), best]
        return self.distance

    def command(self, poses: Array) -> Array:
        """Return the commands at poses x, y (m) and yaw (rad), (n, 3): c_v, m/s, and c_ω, rad/s, (n, 2)."""
        config = self.config
        self.locate(poses)
        ahead = max(config.min_look_ahead, config.look_ahead * config.speed)
        target = self._at(np.minimum(self.progress + round(ahead / STEP), self._last)) - poses[:, :2]
        distance = np.maximum(np.linalg.norm(target, axis=-1), 1e-6)
        lateral = np.cos(poses[:, 2]) * target[:, 1] - np.sin(poses[:, 2]) * target[:, 0]
        curvature = 2.0 * lateral / np.maximum(distance, config.min_look_ahead) ** 2
        left = (self._last - self.progress) * STEP
        speed = np.minimum(config.speed, np.sqrt(2.0 * config.deceleration * left))
        speed = np.minimum(speed, config.max_yaw_rate / np.maximum(np.abs(curvature), 1e-6))
        return np.stack([speed, np.clip(curvature * speed, -config.max_yaw_rate, config.max_yaw_rate)], -1)

    def reached(self, poses: Array) -> NDArray[np.bool_]:
        """Return which robots are at their goal, (n,)."""
        return np.linalg.norm(poses[:, :2] - self.goals, axis=-1) <= self.config.goal_radius

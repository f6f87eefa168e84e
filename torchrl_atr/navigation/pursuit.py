"""Pure pursuit: the command (c_v, c_ω) that follows a path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchrl_atr._checks import check_number
from torchrl_atr._errors import InputError
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.navigation.paths import STEP, Path

Array = NDArray[np.float64]
SEARCH = 2.0
"""Distance ahead of the last nearest point in which the next one is looked for, m: where a path crosses itself, another
branch is nearer."""
RESPONSES = {"riding": 2.0}
"""``response`` for policies of a task, s; others turn at once. A board must lean before it turns."""
SMOOTHING = 0.1
"""Time constant of the speed and the yaw rate that predict a pose, s."""


@dataclass(frozen=True)
class PursuitConfig:
    """Parameters of pure pursuit.

    Attributes:
        speed: cruising speed, m/s.
        max_yaw_rate: largest |c_ω|, rad/s.
        look_ahead: seconds of travel that the pursued point is ahead, s.
        min_look_ahead: least distance to that point, m.
        response: seconds that a commanded yaw rate takes to be turned at, s. The pursuit begins where the robot will be
            by then: a vehicle that turns late weaves about its path otherwise.
        deceleration: with which the speed falls before the goal, m/s².
        goal_radius: distance at which the goal is reached, m.

    Raises:
        InputError: for a number that is not positive, or a negative response.

    Example:
        >>> PursuitConfig(speed=3.0).look_ahead
        1.0
    """

    speed: float = 1.5
    max_yaw_rate: float = 1.0
    look_ahead: float = 1.0
    min_look_ahead: float = 1.0
    response: float = 0.0
    deceleration: float = 0.5
    goal_radius: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_number(name, value, 0.0, above=None if name == "response" else 0.0)


class PurePursuit:
    """Pure pursuit of n paths by n robots at once.

    The curvature of the arc to the pursued point at distance L and lateral offset y is κ = 2 y / L², with L at least
    ``min_look_ahead``. The commands are c_v, which falls before the goal and where κ c_v would exceed the largest yaw
    rate, and c_ω = κ c_v. Distance and offset are those from where a robot will be after ``response`` seconds at its
    present speed and yaw rate, which are means over the last :data:`SMOOTHING` seconds of calls.

    Args:
        paths: one for each robot.
        config: parameters; by default 1.5 m/s.
        dt: time between two calls of :meth:`command`, s.

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

    def __init__(self, paths: Sequence[Path], config: PursuitConfig | None = None, dt: float = CONTROL_DT) -> None:
        if not paths:
            raise InputError("pure pursuit needs a path for each robot; got none")
        self.config = config or PursuitConfig()
        self._last = np.array([len(path.points) - 1 for path in paths])
        longest = int(self._last.max()) + 1
        self._points = np.stack([np.pad(p.points, ((0, longest - len(p.points)), (0, 0)), mode="edge") for p in paths])
        self.progress, self.distance = np.zeros(len(paths), dtype=int), np.zeros(len(paths))
        self.dt = check_number("dt", dt, above=0.0)
        self._before: Array | None = None
        self._rates = np.zeros((len(paths), 2))

    @property
    def goals(self) -> Array:
        """Ends of the paths, (n, 2)."""
        return self._at(self._last)

    def _at(self, index: NDArray[np.int64]) -> Array:
        return self._points[np.arange(len(index)), index]

    def locate(self, poses: Array) -> Array:
        """Advance :attr:`progress` to the nearest points ahead, and return the distances to them, m, (n,)."""
        self.progress, self.distance = self._nearest(poses, SEARCH)
        return self.distance

    def _nearest(self, poses: Array, search: float) -> tuple[NDArray[np.int64], Array]:
        """Return the nearest points within a distance ahead, and the distances to them, m."""
        window = np.arange(round(search / STEP) + 1)
        index = np.minimum(self.progress[:, None] + window, self._last[:, None])
        near = np.take_along_axis(self._points, index[..., None], 1)
        distance = np.linalg.norm(near - poses[:, None, :2], axis=-1)
        rows, best = np.arange(len(index)), distance.argmin(-1)
        return index[rows, best], distance[rows, best]

    def _predicted(self, poses: Array) -> Array:
        """Return the poses after the response time, along arcs."""
        if self._before is not None:
            moved = poses - self._before
            forward = (moved[:, :2] * _heading(poses[:, 2])).sum(-1)
            turned = (moved[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
            rates = np.stack([forward, turned], -1) / self.dt
            self._rates += min(1.0, self.dt / SMOOTHING) * (rates - self._rates)
        self._before = poses.copy()
        ahead, turn = self.config.response * self._rates.T
        places = poses[:, :2] + ahead[:, None] * _heading(poses[:, 2] + turn / 2.0)
        return np.concatenate([places, (poses[:, 2] + turn)[:, None]], -1)

    def command(self, poses: Array) -> Array:
        """Return the commands at poses x, y (m) and yaw (rad), (n, 3): c_v, m/s, and c_ω, rad/s, (n, 2)."""
        config = self.config
        self.locate(poses)
        later = self._predicted(poses)
        nearest, _ = self._nearest(later, SEARCH + config.response * config.speed)
        ahead = max(config.min_look_ahead, config.look_ahead * config.speed)
        target = self._at(np.minimum(nearest + round(ahead / STEP), self._last)) - later[:, :2]
        distance = np.maximum(np.linalg.norm(target, axis=-1), 1e-6)
        lateral = np.cos(later[:, 2]) * target[:, 1] - np.sin(later[:, 2]) * target[:, 0]
        curvature = 2.0 * lateral / np.maximum(distance, config.min_look_ahead) ** 2
        left = (self._last - self.progress) * STEP
        speed = np.minimum(config.speed, np.sqrt(2.0 * config.deceleration * left))
        speed = np.minimum(speed, config.max_yaw_rate / np.maximum(np.abs(curvature), 1e-6))
        return np.stack([speed, np.clip(curvature * speed, -config.max_yaw_rate, config.max_yaw_rate)], -1)

    def reached(self, poses: Array) -> NDArray[np.bool_]:
        """Return which robots are at their goal, (n,)."""
        return np.linalg.norm(poses[:, :2] - self.goals, axis=-1) <= self.config.goal_radius


def _heading(yaw: Array) -> Array:
    return np.stack([np.cos(yaw), np.sin(yaw)], -1)

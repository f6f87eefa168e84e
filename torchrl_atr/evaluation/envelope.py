"""Bounds of the commands that a riding robot can follow, from friction and from the reward."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torchrl.envs import EnvBase

from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.models.boards import Transporter
from torchrl_atr.envs.tasks import RewardTerm, Task
from torchrl_atr.envs.tasks.common_rewards import KERNEL_WIDTH, yaw_rate_tracking
from torchrl_atr.envs.tasks.riding.rewards import position_alignment
from torchrl_atr.envs.tasks.state import GRAVITY

Array = NDArray[np.float64]
SETTLED_YAW_ERROR = 0.3
"""Settled yaw error below which a command counts as followed, rad/s."""


@dataclass(frozen=True)
class Envelope:
    """Bounds of a steady turn of a robot on a transporter, from friction and from the reward.

    A transporter that drives at v and turns at ω accelerates sideways by v ω. Three things follow:

    - The feet hold while |v ω| ≤ μ g.
    - On a board that tilts to the side, the robot's ZMP must stay at the pivot, where it balances, so its centre of
      mass, h above the pivot, leans inwards by h |v ω| / g, and r2, its distance from the pivot, costs
      w2 h |v ω| / g per second. Boards that do not tilt to the side need no lean: w2 counts as 0.
    - r1, as printed, earns w1 exp(-|c_ω - ω| / σ) per second, so at the speed v the best steady turn has the ω that
      maximises

      f(ω) = w1 exp(-(|c_ω| - ω) / σ) - w2 h |v| ω / g,  0 ≤ ω ≤ min(|c_ω|, μ g / |v|).

    f is convex, so its maximum is at an end: the commanded turn, as far as friction holds, or none. Where friction does
    not bind, turning pays up to |v| = w1 (1 - exp(-|c_ω| / σ)) g / (w2 h |c_ω|).

    This is a bound, not a forecast: the tilt that a turn takes against resistance makes the robot lean further, and
    pushes, sensors and transients cost, too. A robot that crouches lowers h at little cost in r7: pass ``height`` to
    compute the effect.

    Attributes:
        yaw_weight: w1, reward per second.
        lean_weight: w2, reward per second and metre; 0 where no lean is needed.
        height: h, of the standing trunk above the hinges of the board, m.
        friction: μ between feet and board.
        width: σ of r1's kernel, rad/s.

    Example:
        >>> from torchrl_atr.envs.tasks import riding
        >>> envelope = Envelope.of(riding("a1", "single_board"))
        >>> round(envelope.height, 3), envelope.follows([2.0, 12.0], [0.0, 1.0]).tolist()
        (0.305, [[True, True], [True, False]])
    """

    yaw_weight: float
    lean_weight: float
    height: float
    friction: float
    width: float = KERNEL_WIDTH

    @classmethod
    def of(cls, task: Task, height: float | None = None) -> Envelope | None:
        """Return a task's envelope; None without a transporter, or without r1 and r2.

        Args:
            task: its rewards give the weights, robot and transporter h, its parameter ``friction`` the nominal μ.
            height: h, m; from ``standing_height`` and the board's thickness by default.
        """
        yaw, lean = (_weight(task.rewards, function) for function in (yaw_rate_tracking, position_alignment))
        friction = task.intrinsics.get("friction")
        if not isinstance(task.support, Transporter) or friction is None or yaw <= 0 or lean > 0:
            return None
        standing = task.robot.standing_height + task.support.spec.size[2] / 2
        tilts = any(task.support.spec.design.attitude[1])  # to the side; else the ZMP may be anywhere between the feet
        lean = 0.0 - lean if tilts else 0.0
        return cls(yaw, lean, standing if height is None else height, friction.nominal)

    def friction_yaw_rate(self, speeds: ArrayLike, yaw_rates: ArrayLike) -> Array:
        """Compute the largest |ω| up to each command that friction allows, rad/s.

        Args:
            speeds: c_v, m/s, (V,).
            yaw_rates: c_ω, rad/s, (W,).

        Returns:
            (V, W).
        """
        speed, asked = _grid(speeds, yaw_rates)
        with np.errstate(divide="ignore"):
            return np.minimum(asked, self.friction * GRAVITY / speed)

    def best_yaw_rate(self, speeds: ArrayLike, yaw_rates: ArrayLike) -> Array:
        """Compute the steady |ω| of the largest reward, rad/s, (V, W); arguments as of :meth:`friction_yaw_rate`."""
        speed, asked = _grid(speeds, yaw_rates)
        most = self.friction_yaw_rate(speeds, yaw_rates)
        earned = self.yaw_weight * (np.exp((most - asked) / self.width) - np.exp(-asked / self.width))
        cost = self.lean_weight * self.height * speed * most / GRAVITY
        return np.where(earned >= cost, most, 0.0)

    def yaw_error(self, speeds: ArrayLike, yaw_rates: ArrayLike, reward: bool = True) -> Array:
        """Compute the settled yaw error of the best policy, rad/s, (V, W); without ``reward``, by friction alone."""
        best = self.best_yaw_rate if reward else self.friction_yaw_rate
        return _grid(speeds, yaw_rates)[1] - best(speeds, yaw_rates)

    def follows(
        self, speeds: ArrayLike, yaw_rates: ArrayLike, reward: bool = True, error: float = SETTLED_YAW_ERROR
    ) -> NDArray[np.bool_]:
        """Return a mask of the commands that the best policy follows within ``error``, rad/s, (V, W) bool."""
        return self.yaw_error(speeds, yaw_rates, reward) <= error + 1e-9

    def share(
        self,
        max_speed: float,
        max_yaw_rate: float,
        reward: bool = True,
        error: float = SETTLED_YAW_ERROR,
        cells: int = 600,
    ) -> float:
        """Compute the share of a box of commands that the best policy follows.

        Args:
            max_speed: largest |c_v|, m/s.
            max_yaw_rate: largest |c_ω|, rad/s.
            reward: whether the reward counts, or friction alone.
            error: largest error at which a command counts as followed, rad/s.
            cells: per side of the grid over a quarter of the box whose midpoints are counted.
        """
        middles = (np.arange(cells) + 0.5) / cells
        return float(self.follows(max_speed * middles, max_yaw_rate * middles, reward, error).mean())


def envelope_of(env: EnvBase) -> Envelope | None:
    """Return the envelope of an env's task; None for other base envs, and for tasks that have none."""
    base = base_env(env)
    return Envelope.of(base.task) if isinstance(base, QuadrupedEnv) else None


def _weight(rewards: Mapping[str, RewardTerm], function: Callable[..., Any]) -> float:
    return sum(term.weight for term in rewards.values() if term.function is function)


def _grid(speeds: ArrayLike, yaw_rates: ArrayLike) -> tuple[Array, Array]:
    speed, asked = (np.abs(np.asarray(values, dtype=np.float64)) for values in (speeds, yaw_rates))
    return np.broadcast_arrays(speed[:, None], asked[None, :])  # type: ignore[return-value]

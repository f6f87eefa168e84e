"""Reading of one robot's step from the env's entries, the simulation state and the policy's estimates."""

from __future__ import annotations

from typing import Any

import numpy as np
from tensordict import NestedKey, TensorDictBase
from torchrl.envs import EnvBase

from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.tasks.state import GRAVITY
from torchrl_atr.evaluation.access import achieved_speeds
from torchrl_atr.evaluation.energy import measure_power, robot_mass
from torchrl_atr.modules import NetworkKeys
from torchrl_atr.viewer.readings import Reading

_KEYS = NetworkKeys()


class Sensing:
    """Reader of :class:`~torchrl_atr.viewer.readings.Reading` from an env's steps.

    Args:
        env: a QuadrupedEnv behind the standard transforms, whose task observes ``speeds``.
    """

    def __init__(self, env: EnvBase) -> None:
        self._env, self._base = env, base_env(env)
        self._terms = tuple(self._base.runner.terms.rewards.terms)
        self._followed = list(self._base.followed)

    def read(self, stepped: TensorDictBase, row: int, time: float, fell: bool) -> Reading:
        """Return the reading of a robot.

        Args:
            stepped: the step, with the policy's entries and ``next``.
            row: which robot.
            time: after the step, s.
            fell: whether its episode ended.
        """
        truth = _values(stepped, _KEYS.extrinsic, row)
        estimate = _values(stepped, _KEYS.extrinsic_estimate, row)
        estimate = np.full_like(truth, np.nan) if estimate is None else estimate
        terms = stepped["next", "reward_terms"]
        # after a fall the engine holds the new episode already
        actual = _values(stepped["next"], "speeds", row)
        state = self._base.runner.terms.extractor.read()
        power, tilt = measure_power(self._env, state), getattr(state, "driving_tilt", None)
        return Reading(
            time=time,
            command=_values(stepped, "command", row),
            actual=achieved_speeds(self._env)[row].numpy().astype(float) if actual is None else actual,
            estimated=estimate[self._followed] if self._followed else np.full(2, np.nan),
            truth=truth,
            estimate=estimate,
            tilt=np.zeros(2) if tilt is None else tilt[row].numpy().astype(float),
            joint_power=0.0 if fell else float(power.joints[row].sum()),
            drive_power=0.0 if fell else float(power.drive[row]),
            weight=float(robot_mass(self._env)[row]) * GRAVITY,
            rewards={name: float(terms[name][row]) for name in self._terms},
            fell=fell,
        )


def _values(td: TensorDictBase, key: NestedKey, row: int) -> Any:
    value = td.get(key, None)
    return None if value is None else value[row].detach().numpy().astype(float)

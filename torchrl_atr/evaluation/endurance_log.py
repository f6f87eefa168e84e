"""Record of an endurance evaluation: errors of each second, and time and cause of each fall."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from torchrl_atr.evaluation.access import disturbance_steps, ended_by, extrinsic_components, intrinsic_names
from torchrl_atr.evaluation.estimators import EstimationErrors, EstimatorSums
from torchrl_atr.evaluation.ride import RideStep
from torchrl_atr.modules.keys import NetworkKeys

OVERSPEED = "overspeed"
UNKNOWN = "terminated"
"""Cause of a fall where the env does not report one."""


class EnduranceLog:
    """Recorder of one chunk of n robots; :class:`~torchrl_atr.evaluation.EnduranceResult` describes its figures.

    Args:
        env: of the robots.
        commands: one after the other, (K, n, 2).
        total: control steps of the ride.
        command_steps: control steps of a command.
        settle_steps: control steps at its start that settled errors leave out.
        limit: speeds beyond which a ride counts as a fall, (2,).
        dt: control period, s.
        encoder: writes the true latent; None to leave the latent out.
        keys: names of the entries.
    """

    def __init__(
        self,
        env: EnvBase,
        commands: Tensor,
        total: int,
        command_steps: int,
        settle_steps: int,
        limit: Tensor,
        dt: float,
        encoder: TensorDictModuleBase | None,
        keys: NetworkKeys,
    ) -> None:
        self._env, self._keys, self._dt, self._limit = env, keys, dt, limit
        self._command_steps, self._settle_steps = command_steps, settle_steps
        self._bin = max(1, round(1.0 / dt))
        n, bins = commands.shape[1], -(-total // self._bin)
        components = partial(extrinsic_components, env)
        self._estimates = [EstimatorSums(n, encoder, keys, components) for _ in range(bins)]
        self._pushes = list(disturbance_steps(env).values())
        self._up, self._settled = torch.zeros(2, bins, n, dtype=torch.float64)
        self._error = torch.zeros(bins, n, 2, dtype=torch.float64)
        self._fall, self._push, self._change = torch.full((3, n), math.nan, dtype=torch.float64)
        self._cause = np.full(n, "", dtype=object)
        self._intrinsics = torch.zeros(n, 0)

    def __call__(self, step: RideStep) -> None:
        """Add one step; count robots that are too fast as fallen."""
        if step.index == 0:
            self._intrinsics = step.observed.get(self._keys.intrinsic, self._intrinsics)
        second, since_change = step.index // self._bin, step.index % self._command_steps
        self._up[second] += step.up
        self._estimates[second].add(step.observed, step.decided, step.up)
        if since_change >= self._settle_steps:
            error = (step.speeds - step.command).abs().double()
            self._settled[second] += step.up
            self._error[second] += error.where(step.up.unsqueeze(-1), 0.0)
        too_fast = (step.speeds.abs() > self._limit).any(-1)
        causes = {**ended_by(self._env), UNKNOWN: step.down, OVERSPEED: too_fast}
        step.down = step.down | too_fast
        fallen = (step.up & step.down).nonzero().squeeze(-1)
        if len(fallen):
            self._note_falls(step.index, fallen, causes)

    def _note_falls(self, index: int, rows: Tensor, causes: dict[str, Tensor]) -> None:
        """Record the falls of ``rows``; of several causes the first one counts."""
        done = index + 1
        self._fall[rows] = done * self._dt
        self._change[rows] = (index % self._command_steps + 1) * self._dt
        # pushes come at the start of steps that are multiples of their interval, the first step excepted
        last = max((index // steps * steps for steps in self._pushes), default=0)
        if last > 0:
            self._push[rows] = (done - last) * self._dt
        for row in rows.tolist():
            self._cause[row] = next(name for name, ended in causes.items() if ended[row])

    @property
    def push_seconds(self) -> float:
        """Time between two pushes, s; NaN without pushes."""
        return min(self._pushes) * self._dt if self._pushes else math.nan

    @staticmethod
    def join(logs: Sequence[EnduranceLog]) -> dict[str, Any]:
        """Return the fields of a result that are joined from all chunks."""
        first = logs[0]

        def joined(name: str, axis: int) -> Any:
            return torch.cat([getattr(log, name) for log in logs], axis).double().numpy()

        settled = joined("_settled", 1)
        with np.errstate(invalid="ignore"):
            error = joined("_error", 1) / settled[..., None]
        intrinsics = joined("_intrinsics", 0)
        estimates = _join_estimates([log._estimates for log in logs])
        return {
            "fall_time": joined("_fall", 0),
            "fall_cause": np.concatenate([log._cause for log in logs]).astype(np.str_),
            "since_push": joined("_push", 0),
            "since_command": joined("_change", 0),
            "up_steps": joined("_up", 1),
            "settled_steps": settled,
            "settled_error": error,
            "intrinsics": intrinsics,
            "intrinsic_names": intrinsic_names(first._env, intrinsics.shape[-1]),
            "estimate_error": None if estimates is None else estimates.extrinsic,
            "components": () if estimates is None else estimates.components,
            "latent_error": None if estimates is None else estimates.latent,
            "push_seconds": first.push_seconds,
        }


def _join_estimates(sums: Sequence[Sequence[EstimatorSums]]) -> EstimationErrors | None:
    """Return the estimates' errors of each second and robot, (S, n, ...), from chunks of seconds."""
    by_second = [[part.result() for part in parts] for parts in zip(*sums, strict=True)]
    seconds = [EstimationErrors.join(parts, (-1,)) for parts in by_second]
    n = None if seconds[0] is None else len(seconds[0].steps)
    return None if n is None else EstimationErrors.join(seconds, (len(seconds), n))

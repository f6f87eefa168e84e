"""Observations of riding (Table I): proprioception, extrinsic privileged state, additional critic inputs."""

from __future__ import annotations

from collections.abc import Mapping

from tensordict import NestedKey
from torch import Tensor

from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.tasks import mirrors
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.dead_reckoning import KEY
from torchrl_atr.envs.tasks.observation_terms import Group, ObservationTerm
from torchrl_atr.envs.tasks.proprioception import BODY, SPEEDS
from torchrl_atr.envs.tasks.riding.forecast import FORECAST_MIRROR, tracking_forecast
from torchrl_atr.envs.tasks.rotations import rotate_back


def platform_velocity(c: StepContext) -> Tensor:
    """Return v_P in the body frame, m/s, (N, 3)."""
    return rotate_back(c.state.rotation, c.state.platform_velocity)


def platform_angular_velocity(c: StepContext) -> Tensor:
    """Return ω_P in the body frame, rad/s, (N, 3)."""
    return rotate_back(c.state.rotation, c.state.platform_angular_velocity)


def relative_position(c: StepContext) -> Tensor:
    """Return p_B,xy in the frame of P, m, (N, 2)."""
    return c.state.relative_position


def relative_yaw(c: StepContext) -> Tensor:
    """Return θ_B,z in the frame of P, rad, (N, 1)."""
    return c.state.relative_yaw


EXTRINSIC: Group = {
    **BODY,
    "platform_velocity": ObservationTerm(platform_velocity, mirrors.POLAR, parts="xyz", unit="m/s"),
    "platform_angular_velocity": ObservationTerm(platform_angular_velocity, mirrors.AXIAL, parts="xyz", unit="rad/s"),
    "relative_position": ObservationTerm(relative_position, mirrors.POLAR[:2], parts="xy", unit="m"),
    "relative_yaw": ObservationTerm(relative_yaw, mirrors.AXIAL[2:], unit="rad"),
}
"""x_ext = [c, v_B, v_P, ω_P, p_B,xy in P, θ_B,z in P] by component (Table V's order)."""


def extrinsic(interpretation: Interpretation) -> dict[str, ObservationTerm]:
    """Return x_ext's components: all of :data:`EXTRINSIC`, or without the relative pose (A1)."""
    return {name: term for name, term in EXTRINSIC.items() if interpretation.relative_pose or "relative" not in name}


def observations(interpretation: Interpretation, proprio: Group, dead_reckoned: Group) -> Mapping[NestedKey, Group]:
    """Return the groups of observations of the robot and its critic.

    Args:
        interpretation: which components the extrinsic state has (A1).
        proprio: group of sensor values.
        dead_reckoned: group of the velocity computed from them.
    """
    return {
        "proprio": proprio,
        "speeds": SPEEDS,
        KEY: dead_reckoned,
        ("privileged", "extrinsic"): extrinsic(interpretation),
        ("privileged", "tracking_forecast"): {"tracking_forecast": ObservationTerm(tracking_forecast, FORECAST_MIRROR)},
    }

"""Observations: proprio (o_t without the command) and the extrinsic privileged state, as named components.

Adding a component is one entry in a table; sizes, slices and labels follow from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torchrl_atr.envs.models.robot import LEGS
from torchrl_atr.envs.profiles import Readings
from torchrl_atr.envs.task.rotations import rotate_about, rotate_back
from torchrl_atr.envs.task.state import CONTROL_DT, GRAVITY, RidingState


def body_acceleration(state: RidingState, readings: Readings) -> Tensor:
    """v̇_B in the body frame, m/s², (N, 3); with gravity's reaction if the profile asks for an IMU (A18)."""
    if readings.gravity_in_acceleration:
        return state.body_acceleration + GRAVITY * state.rotation[:, 2]
    return state.body_acceleration


PROPRIO: dict[str, Callable[[RidingState, Readings], Tensor]] = {
    "acceleration": body_acceleration,
    "angular_velocity": lambda state, _: state.angular_velocity,
    "orientation": lambda state, _: state.euler[:, :2],
    "joint_position": lambda state, _: state.joint_position,
    "joint_velocity": lambda state, _: state.joint_velocity,
}
"""o_m = [v̇_B, ω_B, θ_xy, q, q̇] by component."""

EXTRINSIC: dict[str, Callable[[RidingState], Tensor]] = {
    "contacts": lambda state: state.contacts,
    "body_velocity": lambda state: rotate_back(state.rotation, state.velocity),
    "platform_velocity": lambda state: rotate_back(state.rotation, state.platform_velocity),
    "platform_angular_velocity": lambda state: rotate_back(state.rotation, state.platform_angular_velocity),
    "relative_position": lambda state: state.relative_position,
    "relative_yaw": lambda state: state.relative_yaw,
}
"""x_ext = [c, v_B, v_P, ω_P, p_B,xy in P, θ_B,z in P] by component (Table V's order)."""

EXTRINSIC_LABELS: dict[str, tuple[str, Sequence[str], str]] = {
    "contacts": ("contact", LEGS, "1"),
    "body_velocity": ("body velocity", "xyz", "m/s"),
    "platform_velocity": ("platform velocity", "xyz", "m/s"),
    "platform_angular_velocity": ("platform angular velocity", "xyz", "rad/s"),
    "relative_position": ("relative position", "xy", "m"),
    "relative_yaw": ("relative yaw", ("",), "rad"),
}
"""What each component is called in tables, its parts, and its unit."""


def dead_reckoning(velocity: Tensor, state: RidingState) -> Tensor:
    """Body velocity a control step later from what an IMU measures: turned back by ω_B dt, plus v̇_B dt.

    A history of 0.2 s sees speed only through the resistance, 0.06 m/s² for each m/s; from a start at rest the
    integral of the acceleration knows it. It drifts with the bias of a real accelerometer.

    Args:
        velocity: before the step, body frame, m/s, (N, 3).
        state: after it.

    Returns:
        (N, 3), body frame, m/s.
    """
    turned = rotate_about(velocity, -CONTROL_DT * state.angular_velocity)
    return turned + CONTROL_DT * state.body_acceleration


def proprio(state: RidingState, previous_action: Tensor, readings: Readings) -> Tensor:
    """o_t without the command: o_m and a_{t-1}.

    Args:
        state: N robots.
        previous_action: a_{t-1}, (N, 12), as the policy gave it.
        readings: A18.

    Returns:
        (N, 32 + 12), raw SI units.
    """
    return torch.cat([*(component(state, readings) for component in PROPRIO.values()), previous_action], -1)


def extrinsic_components(readings: Readings) -> tuple[str, ...]:
    """Names of x_ext's components: all of :data:`EXTRINSIC`, or without the relative pose (A1)."""
    return tuple(name for name in EXTRINSIC if readings.relative_pose or not name.startswith("relative"))


def extrinsic_label(name: str) -> tuple[str, str | None]:
    """Return what a state that is named like ``body_velocity[0]`` is called in tables, and its unit.

    Another env's names stay as they are, without a unit.

    Example:
        >>> extrinsic_label("body_velocity[0]"), extrinsic_label("contacts[3]"), extrinsic_label("relative_yaw[0]")
        (('body velocity x', 'm/s'), ('contact RL', '1'), ('relative yaw', 'rad'))
        >>> extrinsic_label("wind[0]")
        ('wind[0]', None)
    """
    component, _, index = name.removesuffix("]").partition("[")
    label, parts, unit = EXTRINSIC_LABELS.get(component, ("", (), ""))
    if not index.isdigit() or int(index) >= len(parts):
        return name, None
    return f"{label} {parts[int(index)]}".rstrip(), unit


def extrinsic(state: RidingState, readings: Readings) -> Tensor:
    """x_ext, (N, 16), or (N, 13) without the relative pose, raw SI units."""
    return torch.cat([EXTRINSIC[name](state) for name in extrinsic_components(readings)], -1)

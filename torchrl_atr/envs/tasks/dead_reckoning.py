"""Velocity by dead reckoning from the robot's IMU: four methods."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchrl_atr._checks import check_choice
from torchrl_atr.envs.physics.engine import CONTROL_DT
from torchrl_atr.envs.tasks import mirrors
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.memory_terms import MemoryTerm
from torchrl_atr.envs.tasks.observation_terms import Group, ObservationTerm
from torchrl_atr.envs.tasks.rotations import matrix_from_euler, rotate, rotate_about, rotate_back
from torchrl_atr.envs.tasks.state import GRAVITY

KEY = "dead_reckoned_velocity"
"""Name of the memory term, and of the group that observes it."""
LEAK_TIME = 10.0
"""Time constant τ of the leaky integral, s."""
BIAS, BIAS_TIME = 0.05, 100.0
"""Standard deviation (m/s²) and correlation time (s) of the accelerometer bias that the filter assumes."""
ACCELERATION_NOISE = 0.1
"""Standard deviation of the accelerometer's white noise that the filter assumes, m/s²."""
START_STD = 0.01
"""Standard deviation of the velocity at the start of an episode, m/s."""
SIDE_SLIP = 1.0
"""Standard deviation of the speed to the side, taken as a measurement of zero at every step, m/s.

Larger than the slip itself, centimetres a second: slips of successive steps are alike, which a filter of independent
measurements does not know. Of 0.5, 1, 2 and 4 m/s this one has the smallest error after a minute with pushes.
"""
ALIGNED_SIDE_SLIP = 0.4
"""The same across the transporter's heading, m/s, for the filter that knows where that is."""
YAW_START_STD, YAW_NOISE = 0.05, 0.025
"""Standard deviation of the yaw relative to the transporter at the start, rad, and of its random walk, rad/√s."""
LARGEST_YAW = 0.7
"""Bound of that yaw, rad: far beyond it the linearised filter does not find back."""


def _start(c: StepContext) -> Tensor:
    """Return v_B in the body frame, m/s, (n, 3): the velocity at the start of an episode is taken as known."""
    return rotate_back(c.state.rotation, c.state.velocity)


def _acceleration(c: StepContext) -> Tensor:
    """Return the measured v̇_B without gravity, body frame, m/s², (N, 3)."""
    measured = c.sensed("acceleration")
    if not c.interpretation.gravity_in_acceleration:
        return measured
    roll, pitch = c.sensed("orientation").unbind(-1)
    return measured - GRAVITY * matrix_from_euler(roll, pitch, torch.zeros_like(roll))[:, 2]


def integral(c: StepContext, key: str = KEY) -> Tensor:
    """Integrate the measured acceleration: the previous velocity, rotated back by ω_B dt, plus v̇_B dt.

    Exact with exact sensors; the bias of a real accelerometer, 0.05 m/s², makes it drift by 3 m/s in a minute.

    Args:
        c: its memory ``key`` is the velocity before the step, body frame, m/s, (N, 3).
        key: name of the memory term.

    Returns:
        (N, 3), body frame, m/s.
    """
    turned = rotate_about(c.memory[key], -CONTROL_DT * c.sensed("angular_velocity"))
    return turned + CONTROL_DT * _acceleration(c)


def leaky_integral(c: StepContext, key: str = KEY) -> Tensor:
    """Integrate likewise, with a leak of :data:`LEAK_TIME`: errors stay bounded, steady speeds decay.

    Returns:
        (N, 3), body frame, m/s.
    """
    return math.exp(-CONTROL_DT / LEAK_TIME) * integral(c, key)


def kalman_filter(c: StepContext, key: str = KEY) -> Tensor:
    """Estimate velocity and accelerometer bias with a Kalman filter under the constraint of no sideways motion.

    The state is [v_x, v_y, b_x, b_y] in the frame that turns with the body's yaw ψ and is level: v̇ = a - b - ψ̇ × v, and
    b is a Gauss-Markov process. At every step v_y = 0 is taken as measured, the nonholonomic constraint of wheeled
    vehicles: in a turn, the lateral acceleration is ψ̇ v_x, which makes errors of v_x, and of b, observable.

    Args:
        c: its memory ``key`` is the state (4) and its covariance (16), (N, 20).
        key: name of the memory term.

    Returns:
        The same after the step, (N, 20), m/s and m/s².
    """
    state, covariance = c.memory[key][:, :4], c.memory[key][:, 4:].unflatten(-1, (4, 4))
    acceleration, yaw_rate = _level(c)
    transition = _transition(yaw_rate)
    state = rotate(transition, state) + pad(CONTROL_DT * acceleration, (0, 2))
    covariance = transition @ covariance @ transition.mT + torch.diag(_PROCESS_NOISE.to(state))
    side = covariance[:, :, 1]  # covariances with v_y
    gain = side / (side[:, 1:2] + SIDE_SLIP**2)
    state = state - gain * state[:, 1:2]
    covariance = covariance - gain.unsqueeze(-1) * side.unsqueeze(-2)
    return torch.cat([state, covariance.flatten(-2)], -1)


def aligned_kalman_filter(c: StepContext, key: str = KEY) -> Tensor:
    """Estimate also the robot's yaw relative to the transporter, θ_B,z, with an extended Kalman filter.

    A robot that pushes have turned on the boards moves obliquely to its own heading: its sideways velocity is v θ_B,z,
    not zero. The state is [v_x, v_y, b_x, b_y, θ_B,z], where θ_B,z is a random walk. The velocity across the
    transporter's heading, v_x sin θ_B,z + v_y cos θ_B,z, is taken as measured as zero. Changes of speed show θ_B,z,
    which no sensor does. After two minutes with pushes, errors of v_x are 0.13 m/s instead of 0.20, and of θ_B,z
    0.07 rad instead of the 0.14 that it is on average (64 robots, rides of a trained policy).

    Args:
        c: its memory ``key`` is the state (5) and its covariance (25), (N, 30).
        key: name of the memory term.

    Returns:
        The same after the step, (N, 30), m/s, m/s² and rad.
    """
    state, covariance = c.memory[key][:, :5], c.memory[key][:, 5:].unflatten(-1, (5, 5))
    acceleration, yaw_rate = _level(c)
    transition = pad(_transition(yaw_rate), (0, 1, 0, 1)) + torch.diag(_KEEPS_YAW.to(state))
    state = rotate(transition, state) + pad(CONTROL_DT * acceleration, (0, 3))
    covariance = transition @ covariance @ transition.mT + torch.diag(_ALIGNED_NOISE.to(state))
    vx, vy, *_, yaw = state.unbind(-1)
    sine, cosine, zero = torch.sin(yaw), torch.cos(yaw), torch.zeros_like(yaw)
    slope = torch.stack([sine, cosine, zero, zero, cosine * vx - sine * vy], -1)
    side = rotate(covariance, slope)  # covariances with the velocity across
    gain = side / ((slope * side).sum(-1, keepdim=True) + ALIGNED_SIDE_SLIP**2)
    state = state - gain * (sine * vx + cosine * vy).unsqueeze(-1)
    covariance = covariance - gain.unsqueeze(-1) * side.unsqueeze(-2)
    yaw = state[:, 4:].clamp(-LARGEST_YAW, LARGEST_YAW)
    return torch.cat([state[:, :4], yaw, covariance.flatten(-2)], -1)


_KEEP = math.exp(-CONTROL_DT / BIAS_TIME)
_PROCESS_NOISE = torch.tensor([(ACCELERATION_NOISE * CONTROL_DT) ** 2] * 2 + [(1.0 - _KEEP**2) * BIAS**2] * 2)
_START_COVARIANCE = torch.diag(torch.tensor([START_STD**2] * 2 + [BIAS**2] * 2))
_KEEPS_YAW = torch.tensor([0.0] * 4 + [1.0])
_ALIGNED_NOISE = torch.cat([_PROCESS_NOISE, torch.tensor([YAW_NOISE**2 * CONTROL_DT])])


def _level(c: StepContext) -> tuple[Tensor, Tensor]:
    """Return the measured acceleration along and across the heading, (N, 2), and the yaw rate, (N,)."""
    roll, pitch = c.sensed("orientation").unbind(-1)
    tilt = matrix_from_euler(roll, pitch, torch.zeros_like(roll))
    _, wy, wz = c.sensed("angular_velocity").unbind(-1)
    yaw_rate = (torch.sin(roll) * wy + torch.cos(roll) * wz) / torch.cos(pitch)
    return rotate(tilt, _acceleration(c))[:, :2], yaw_rate


def _transition(yaw_rate: Tensor) -> Tensor:
    """Return F of the state, (N, 4, 4): v rotated back by the yaw of the step, less b dt, and the constant bias.

    The acceleration is that of the step in the frame after it, and so is its bias.
    """
    angle = CONTROL_DT * yaw_rate
    cosine, sine, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
    keep, step = torch.full_like(angle, _KEEP), torch.full_like(angle, -CONTROL_DT)
    rows = [
        cosine, sine, step, zero,
        -sine, cosine, zero, step,
        zero, zero, keep, zero,
        zero, zero, zero, keep,
    ]  # fmt: skip
    return torch.stack(rows, -1).unflatten(-1, (4, 4))


def _start_filter(c: StepContext) -> Tensor:
    """Return state and covariance at the start of episodes, (n, 20): a known velocity, an unknown bias."""
    heading = c.state.euler.clone()
    heading[:, :2] = 0.0
    velocity = rotate_back(matrix_from_euler(*heading.unbind(-1)), c.state.velocity)[:, :2]
    covariance = _START_COVARIANCE.to(velocity).flatten().expand(len(velocity), -1)
    return torch.cat([pad(velocity, (0, 2)), covariance], -1)


def _start_aligned(c: StepContext) -> Tensor:
    """Return the same of the filter that knows the yaw, (n, 30): the robot is taken to be aligned."""
    start = _start_filter(c)
    covariance = pad(start[:, 4:].unflatten(-1, (4, 4)), (0, 1, 0, 1)) + torch.diag(
        YAW_START_STD**2 * _KEEPS_YAW.to(start)
    )
    return torch.cat([pad(start[:, :4], (0, 1)), covariance.flatten(-2)], -1)


def _velocity(c: StepContext, key: str) -> Tensor:
    return c.memory[key]


def _filtered(c: StepContext, key: str) -> Tensor:
    """Return v_x and v_y along and across the heading, and the standard deviation of v_x, m/s, (N, 3)."""
    memory = c.memory[key]
    return torch.cat([memory[:, :2], memory[:, 4:5].clamp_min(0.0).sqrt()], -1)


def _filtered_with_yaw(c: StepContext, key: str) -> Tensor:
    """Return v_x and v_y, the standard deviation of v_x, θ_B,z and its standard deviation, m/s and rad, (N, 5)."""
    memory = c.memory[key]
    deviations = memory[:, 5:].unflatten(-1, (5, 5)).diagonal(dim1=-2, dim2=-1).clamp_min(0.0).sqrt()
    return torch.cat([memory[:, :2], deviations[:, :1], memory[:, 4:5], deviations[:, 4:]], -1)


class _Method(NamedTuple):
    size: int
    update: Callable[..., Tensor]
    start: Callable[..., Tensor]
    observe: Callable[..., Tensor]
    mirror: tuple[float, ...]
    parts: tuple[str, ...]
    output: str
    unit: str | tuple[str, ...] = "m/s"


_BODY_VELOCITY = "velocity in the body frame, m/s"
_HEADING_VELOCITY = "speed along and across the heading, m/s, and the standard deviation of the first"


METHODS: Mapping[str, _Method] = {
    "integral": _Method(3, integral, _start, _velocity, mirrors.POLAR, ("x", "y", "z"), _BODY_VELOCITY),
    "leaky_integral": _Method(3, leaky_integral, _start, _velocity, mirrors.POLAR, ("x", "y", "z"), _BODY_VELOCITY),
    "kalman_filter": _Method(
        20, kalman_filter, _start_filter, _filtered, (1.0, -1.0, 1.0), ("x", "y", "std"), _HEADING_VELOCITY
    ),
    "aligned_kalman_filter": _Method(
        30,
        aligned_kalman_filter,
        _start_aligned,
        _filtered_with_yaw,
        (1.0, -1.0, 1.0, -1.0, 1.0),
        ("x", "y", "std", "yaw", "yaw std"),
        f"{_HEADING_VELOCITY}; the yaw relative to the transporter, rad, and its standard deviation",
        ("m/s", "m/s", "m/s", "rad", "rad"),
    ),
}
"""Methods by name; each observes a velocity, (N, 3), m/s, the last one also a yaw, (N, 5), m/s and rad."""


def method_of(memory: Mapping[str, MemoryTerm], key: str = KEY) -> str:
    """Return the name of the method by which the memory term ``key`` of a task reckons.

    Raises:
        KeyError: if it is not of :func:`dead_reckoning`.
    """
    names: dict[Any, str] = {method.update: name for name, method in METHODS.items()}
    return names[getattr(memory[key].update, "func", None)]


def dead_reckoning(method: str = "kalman_filter", key: str = KEY) -> tuple[Group, MemoryTerm]:
    """Return the group that observes a dead-reckoned velocity, and the memory term that it needs.

    Args:
        method: one of :data:`METHODS`.
        key: name of the memory term, and of the observation.

    Raises:
        InputError: for an unknown method.

    Example:
        >>> from torchrl_atr.envs.tasks import riding
        >>> task, (group, memory) = riding(), dead_reckoning("integral", "drifting")
        >>> task = task.replace(memory={**task.memory, "drifting": memory}).with_observation("drifting", **group)
    """
    check_choice("method", method, METHODS)
    chosen = METHODS[method]
    term = ObservationTerm(partial(chosen.observe, key=key), chosen.mirror, parts=chosen.parts, unit=chosen.unit)
    return {key: term}, MemoryTerm(chosen.size, partial(chosen.update, key=key), chosen.start)

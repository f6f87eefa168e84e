"""Mechanical power of joints and of the transporter's drive, and the cost of transport."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchrl.envs import EnvBase

from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.tasks.state import GRAVITY

Array = NDArray[np.float64]


class Power(NamedTuple):
    """Positive mechanical power of n robots at one instant, W.

    Attributes:
        joints: max(τ q̇, 0) of each joint, torque and velocity of the same instant, (n, joints).
        drive: power that the transporter's propulsion delivers, resistance included, (n,); 0 without a transporter.
    """

    joints: Tensor
    drive: Tensor


def measure_power(env: EnvBase, state: Any = None) -> Power:
    """Return the power of an env's robots after a step.

    Args:
        env: a QuadrupedEnv, transformed or not.
        state: what its extractor reads now, if that has been read.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> env = make_riding_env(num_envs=2, seed=0)
        >>> _ = env.rollout(3)
        >>> measure_power(env).joints.shape
        torch.Size([2, 12])
    """
    base = base_env(env)
    state = base.runner.terms.extractor.read() if state is None else state
    delivered = getattr(base.engine.hook, "power", None)
    drive = torch.zeros(len(state.torque)) if delivered is None else delivered().float().clamp_min(0.0)
    return Power((state.torque * state.torque_velocity).clamp_min(0.0), drive)


def robot_mass(env: EnvBase) -> Tensor:
    """Return the mass of each robot with its payload, without the transporter, kg, (N,)."""
    engine = base_env(env).engine
    masses = engine.fields["body_mass"]
    boards = getattr(engine.scene.support_layout, "board_bodies", [])
    return (masses.sum(-1) - masses[:, torch.as_tensor(boards, dtype=torch.long)].sum(-1)).float()


class CostOfTransport(NamedTuple):
    """Cost of transport of a trip: power over m g v, with the robot's mass m and its mean speed v.

    Attributes:
        paper: from the mean over joints of the positive power, as in the paper's Sec. V-B.
        joints: from the sum over joints.
        system: from the sum over joints and the transporter's drive.
    """

    paper: Array
    joints: Array
    system: Array


def cost_of_transport(joints: Array, drive: Array, mass: Array, speed: Array, count: int) -> CostOfTransport:
    """Compute the cost of transport of n trips.

    Args:
        joints: mean over a trip of the positive power, summed over joints, W, (n,).
        drive: mean power of the drive, W, (n,).
        mass: of the robots, kg, (n,).
        speed: mean speeds, m/s, (n,).
        count: number of joints.

    Example:
        >>> cost = cost_of_transport(*np.array([[120.0], [60.0], [10.0], [1.0]]), count=12)
        >>> [round(float(value[0]), 3) for value in cost]
        [0.102, 1.223, 1.835]
    """
    weight = mass * GRAVITY * speed
    return CostOfTransport(joints / count / weight, joints / weight, (joints + drive) / weight)

"""Trot gait by a clock, which runs faster with the commanded speed and stops for standing still."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchrl_atr.envs.physics.engine import CONTROL_DT
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.memory_terms import MemoryTerm

FREQUENCY = (2.0, 0.5)
"""Step frequency of a leg, Hz: at rest, and its increase per m/s of the commanded speed."""
DUTY = 0.5
"""Share of a cycle that a leg is in stance."""
SWING_HEIGHT = 0.06
"""Highest point of a swing above the stand, m."""
MOVING = 0.1
"""Commands below this, m/s and rad/s, mean standing still."""
LEG_PHASE = torch.tensor([0.0, 0.5, 0.5, 0.0])
"""Phases of FR, RR, FL, RL: diagonal legs together."""


def moving(c: StepContext) -> Tensor:
    """Return 1 where the command is more than standing still, (N,)."""
    return (c.command.abs() > MOVING).any(-1).to(c.command.dtype)


def _advance(c: StepContext) -> Tensor:
    frequency = FREQUENCY[0] + FREQUENCY[1] * c.command[:, :1].abs()
    return (c.memory["phase"] + CONTROL_DT * frequency) % 1.0


def _air_time(c: StepContext) -> Tensor:
    return torch.where(c.state.contacts > 0, 0.0, c.memory["air_time"] + CONTROL_DT)


MEMORY = {"phase": MemoryTerm(1, _advance), "air_time": MemoryTerm(4, _air_time)}
"""Memory terms of the gait: the clock's phase in [0, 1), and the air time of each foot, s."""


def clock(c: StepContext) -> Tensor:
    """Return sine and cosine of the clock's phase; zero while the robot is to stand still, (N, 2)."""
    angle = 2.0 * math.pi * c.memory["phase"]
    return moving(c).unsqueeze(-1) * torch.cat([angle.sin(), angle.cos()], -1)


CLOCK_MIRROR = (-1.0, -1.0)
"""Left and right legs are half a cycle apart."""


def gait(c: StepContext) -> Tensor:
    """Return the score of the trot: feet on the ground in stance, at the height of the swing in the air, (N,)."""
    phase = (c.memory["phase"] + LEG_PHASE) % 1.0
    swing = 1.0 - DUTY
    swinging = (phase < swing).to(c.action.dtype) * moving(c).unsqueeze(-1)
    target = SWING_HEIGHT * torch.sin(math.pi * (phase / swing).clamp(max=1.0))
    kept = 1.0 - (c.state.foot_height - target).abs() / SWING_HEIGHT
    return (swinging * kept + (1.0 - swinging) * c.state.contacts).mean(-1)

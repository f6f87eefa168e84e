"""What moves: the drive law in one home, and two engines under one interface."""

from torchrl_atr.envs.physics.engine import DECIMATION, Engine, PhysicalParameters
from torchrl_atr.envs.physics.law import DriveLaw

__all__ = ["DECIMATION", "DriveLaw", "Engine", "PhysicalParameters"]

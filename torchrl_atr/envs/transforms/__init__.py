"""Transforms of a task's environment: the command curriculum, the observation history, and their order."""

from torchrl_atr.envs.transforms.compact_storage import CompactStorage
from torchrl_atr.envs.transforms.curriculum import CommandCurriculum
from torchrl_atr.envs.transforms.foot_repositioning import FootRepositioning
from torchrl_atr.envs.transforms.grid import CommandGrid
from torchrl_atr.envs.transforms.history import ObservationHistory
from torchrl_atr.envs.transforms.overspeed import OverspeedTermination
from torchrl_atr.envs.transforms.slew import CommandSlew
from torchrl_atr.envs.transforms.stack import task_transforms
from torchrl_atr.envs.transforms.step_counter import RandomizedStepCounter, TimeLimitGrowth

__all__ = [
    "CommandCurriculum",
    "CommandGrid",
    "CommandSlew",
    "CompactStorage",
    "FootRepositioning",
    "ObservationHistory",
    "OverspeedTermination",
    "RandomizedStepCounter",
    "TimeLimitGrowth",
    "task_transforms",
]

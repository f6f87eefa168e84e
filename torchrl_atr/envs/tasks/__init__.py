"""Tasks as data: the classes of their terms, and the package's tasks."""

from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.events import Disturbance, InitialState
from torchrl_atr.envs.tasks.intrinsic_parameters import IntrinsicError, IntrinsicParameter
from torchrl_atr.envs.tasks.memory_terms import MemoryTerm, MemoryTermError
from torchrl_atr.envs.tasks.observation_terms import ObservationError, ObservationTerm
from torchrl_atr.envs.tasks.registry import TASKS, make_task
from torchrl_atr.envs.tasks.reward_terms import RewardError, RewardTerm
from torchrl_atr.envs.tasks.riding import RIDING_REWARDS, riding
from torchrl_atr.envs.tasks.state import QuadrupedState, StateExtractor
from torchrl_atr.envs.tasks.task import CommandSpace, Task
from torchrl_atr.envs.tasks.walking import WALKING_REWARDS, walking

__all__ = [
    "RIDING_REWARDS",
    "TASKS",
    "WALKING_REWARDS",
    "CommandSpace",
    "Disturbance",
    "InitialState",
    "IntrinsicError",
    "IntrinsicParameter",
    "MemoryTerm",
    "MemoryTermError",
    "ObservationError",
    "ObservationTerm",
    "QuadrupedState",
    "RewardError",
    "RewardTerm",
    "StateExtractor",
    "StepContext",
    "Task",
    "make_task",
    "riding",
    "walking",
]

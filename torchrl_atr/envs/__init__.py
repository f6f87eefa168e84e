"""Tasks of quadrupeds as TorchRL envs, their transforms, and a dm_control suite."""

from torchrl_atr.envs.env import QuadrupedEnv
from torchrl_atr.envs.factory import make_env, make_riding_env
from torchrl_atr.envs.interpretation import PROFILES, Interpretation, get_interpretation
from torchrl_atr.envs.models import (
    ROBOTS,
    SINGLE_BOARD,
    TRANSPORTERS,
    TWO_BOARD,
    RobotError,
    RobotSpec,
    TransporterError,
    TransporterSpec,
    get_robot,
    get_transporter,
    read_robot,
    read_transporter,
    register_robot,
)
from torchrl_atr.envs.physics import Simulation
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks import RIDING_REWARDS, RewardError, RewardTerm, Task, make_task, riding, walking
from torchrl_atr.envs.workers import reconfigure

__all__ = [
    "PROFILES",
    "RIDING_REWARDS",
    "ROBOTS",
    "SINGLE_BOARD",
    "TRANSPORTERS",
    "TWO_BOARD",
    "Interpretation",
    "QuadrupedEnv",
    "RewardError",
    "RewardTerm",
    "RidingEnv",
    "RobotError",
    "RobotSpec",
    "Simulation",
    "Task",
    "TransporterError",
    "TransporterSpec",
    "get_interpretation",
    "get_robot",
    "get_transporter",
    "make_env",
    "make_riding_env",
    "make_task",
    "read_robot",
    "read_transporter",
    "reconfigure",
    "register_robot",
    "riding",
    "walking",
]

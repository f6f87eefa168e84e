"""The riding task: robots on transporters as TorchRL envs, their transforms, and a dm_control suite."""

from torchrl_atr.envs.factory import make_riding_env
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
from torchrl_atr.envs.profiles import PROFILES, Readings, get_readings
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.task.reward_terms import RewardError, RewardTerm
from torchrl_atr.envs.task.rewards import RIDING_REWARDS

__all__ = [
    "PROFILES",
    "RIDING_REWARDS",
    "ROBOTS",
    "SINGLE_BOARD",
    "TRANSPORTERS",
    "TWO_BOARD",
    "Readings",
    "RewardError",
    "RewardTerm",
    "RidingEnv",
    "RobotError",
    "RobotSpec",
    "TransporterError",
    "TransporterSpec",
    "get_readings",
    "get_robot",
    "get_transporter",
    "make_riding_env",
    "read_robot",
    "read_transporter",
    "register_robot",
]

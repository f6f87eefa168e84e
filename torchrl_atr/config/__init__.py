"""Configuration of a run: typed settings in groups, presets, and how Python, files and the command line set them."""

from torchrl_atr._settings import ConfigError
from torchrl_atr.config.env_settings import CurriculumConfig, EnvConfig, TaskConfig
from torchrl_atr.config.estimator_settings import EstimatorConfig
from torchrl_atr.config.learning_settings import (
    ComputeConfig,
    ExplorationConfig,
    LoggingConfig,
    PPOConfig,
    ROAConfig,
)
from torchrl_atr.config.presets import PRESETS, TASK_SETTINGS, additions
from torchrl_atr.config.train_config import TrainConfig, make_config, parse_settings, read_config

__all__ = [
    "PRESETS",
    "TASK_SETTINGS",
    "ComputeConfig",
    "ConfigError",
    "CurriculumConfig",
    "EnvConfig",
    "EstimatorConfig",
    "ExplorationConfig",
    "LoggingConfig",
    "PPOConfig",
    "ROAConfig",
    "TaskConfig",
    "TrainConfig",
    "additions",
    "make_config",
    "parse_settings",
    "read_config",
]

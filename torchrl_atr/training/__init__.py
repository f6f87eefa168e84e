"""Training: configuration, trainer, learner, checkpoints and logs."""

from torchrl_atr._threads import TorchThreads
from torchrl_atr.config import (
    PRESETS,
    TASK_SETTINGS,
    ConfigError,
    TrainConfig,
    additions,
    make_config,
    parse_settings,
    read_config,
)
from torchrl_atr.runs.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from torchrl_atr.runs.restoring import checkpoint_config
from torchrl_atr.training.assembly import (
    DEPLOYMENT_OVERRIDES,
    make_env,
    make_policy,
    make_reward_schedule,
    make_run_loss,
    make_run_networks,
)
from torchrl_atr.training.callbacks import Callback, Phase
from torchrl_atr.training.guard import TrainingDiverged
from torchrl_atr.training.learner import Learner
from torchrl_atr.training.loading import commanded_range, load_run
from torchrl_atr.training.parts import EnvFactory, LossFactory, NetworksFactory
from torchrl_atr.training.trainer import Trainer

__all__ = [
    "DEPLOYMENT_OVERRIDES",
    "PRESETS",
    "TASK_SETTINGS",
    "Callback",
    "CheckpointError",
    "ConfigError",
    "EnvFactory",
    "Learner",
    "LossFactory",
    "NetworksFactory",
    "Phase",
    "TorchThreads",
    "TrainConfig",
    "Trainer",
    "TrainingDiverged",
    "additions",
    "checkpoint_config",
    "commanded_range",
    "load_checkpoint",
    "load_run",
    "make_config",
    "make_env",
    "make_policy",
    "make_reward_schedule",
    "make_run_loss",
    "make_run_networks",
    "parse_settings",
    "read_config",
    "save_checkpoint",
]

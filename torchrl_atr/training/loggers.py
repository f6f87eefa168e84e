"""Loggers of TorchRL by the name of the setting ``logger``."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchrl_atr._settings import ConfigError

if TYPE_CHECKING:
    from torchrl.record.loggers import Logger


def check_logger(name: str, logger: Any = None) -> None:
    """Raise a :class:`ConfigError` if a custom logger is none, or the package of the named one is missing."""
    if logger is not None:
        for method in ("log_metrics", "log_hparams"):
            if not hasattr(logger, method):
                raise ConfigError(f"logger={logger!r} lacks {method}; give one of torchrl.record.loggers")
    elif name in ("wandb", "mlflow") and find_spec(name) is None:
        raise ConfigError(
            f"logging.logger={name!r} needs the package {name}: pip install {name}; or take another logger"
        )


def make_logger(name: str, run: Path, title: str, resume_from: int | None = None) -> Logger | None:
    """Return a logger of TorchRL that writes to a run folder, or to the server that its own variables name.

    ``csv`` is None: ``progress.csv`` is written anyway (:class:`~torchrl_atr.training.progress.Progress`). In a run
    that continues from ``resume_from`` frames TensorBoard drops later entries, W&B and MLflow begin another run of the
    same name.
    """
    if name == "csv":
        return None
    if name == "mlflow":
        from torchrl.record.loggers import MLFlowLogger

        # get_logger names a folder, which MLflow 3 no longer takes
        return MLFlowLogger(title, os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{run.resolve() / 'mlflow.db'}")
    from torchrl.record.loggers import get_logger

    if name == "wandb":
        project = os.environ.get("WANDB_PROJECT", "torchrl_atr")
        return get_logger(name, str(run), title, wandb_kwargs={"project": project, "group": run.name})
    logger = get_logger(name, str(run), name)
    if resume_from is not None:  # SummaryWriter's purge_step, which TorchRL's logger does not pass on
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog

        for content in ({"file_version": "brain.Event:2"}, {"session_log": SessionLog(status=SessionLog.START)}):
            logger.experiment.file_writer.add_event(Event(step=resume_from + 1, **content))
    return logger

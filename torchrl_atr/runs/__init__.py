"""Run folders: checkpoint, settings, files and provenance of a run, for what trains it, continues it or reads it."""

from torchrl_atr.runs.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from torchrl_atr.runs.restoring import checkpoint_config

__all__ = ["CheckpointError", "checkpoint_config", "load_checkpoint", "save_checkpoint"]

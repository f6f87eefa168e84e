"""How well it rides: command tracking, its figures, and pictures of it.

Figures and videos import matplotlib, mediapy and OpenGL only when they are made.
"""

from torchrl_atr.evaluation.envelope import Envelope, envelope_of
from torchrl_atr.evaluation.estimators import EstimatorErrors
from torchrl_atr.evaluation.mastery import mastered_range
from torchrl_atr.evaluation.metrics import command_area, do_nothing, tracking_metrics
from torchrl_atr.evaluation.replay import ReplayedStep, replay
from torchrl_atr.evaluation.report import load_tracking, save_tracking, write_report
from torchrl_atr.evaluation.tracking import TrackingResult, command_grid, evaluate_tracking
from torchrl_atr.evaluation.video import DEFAULT_RIDE, record_video
from torchrl_atr.evaluation.viewer import play_viewer

__all__ = [
    "DEFAULT_RIDE",
    "Envelope",
    "EstimatorErrors",
    "ReplayedStep",
    "TrackingResult",
    "command_area",
    "command_grid",
    "do_nothing",
    "envelope_of",
    "evaluate_tracking",
    "load_tracking",
    "mastered_range",
    "play_viewer",
    "record_video",
    "replay",
    "save_tracking",
    "tracking_metrics",
    "write_report",
]

"""Evaluation of trained policies: command tracking, endurance, figures, videos and an interactive viewer.

matplotlib, mediapy and OpenGL are imported only when figures and videos are made.
"""

from torchrl_atr.evaluation.endurance import EnduranceResult, evaluate_endurance
from torchrl_atr.evaluation.endurance_metrics import endurance_metrics
from torchrl_atr.evaluation.endurance_report import load_endurance, save_endurance, write_endurance
from torchrl_atr.evaluation.envelope import Envelope, envelope_of
from torchrl_atr.evaluation.estimators import EstimationErrors
from torchrl_atr.evaluation.mastery import mastered_range
from torchrl_atr.evaluation.metrics import command_area, do_nothing_baseline, tracking_metrics
from torchrl_atr.evaluation.replay import ReplayedStep, replay_failure
from torchrl_atr.evaluation.report import load_tracking, save_tracking, write_report
from torchrl_atr.evaluation.tracking import TrackingResult, command_grid, evaluate_tracking
from torchrl_atr.evaluation.video import DEFAULT_RIDE, record_video
from torchrl_atr.evaluation.viewer import play_viewer

__all__ = [
    "DEFAULT_RIDE",
    "EnduranceResult",
    "Envelope",
    "EstimationErrors",
    "ReplayedStep",
    "TrackingResult",
    "command_area",
    "command_grid",
    "do_nothing_baseline",
    "endurance_metrics",
    "envelope_of",
    "evaluate_endurance",
    "evaluate_tracking",
    "load_endurance",
    "load_tracking",
    "mastered_range",
    "play_viewer",
    "record_video",
    "replay_failure",
    "save_endurance",
    "save_tracking",
    "tracking_metrics",
    "write_endurance",
    "write_report",
]

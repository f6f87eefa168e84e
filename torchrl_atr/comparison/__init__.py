"""Comparison of estimators in one policy: the same states, the same budget, the same rides (docs/compare.md)."""

from torchrl_atr.comparison.options import QUICK, CompareOptions, ComparisonError
from torchrl_atr.comparison.recording import Recording, load_recording, record
from torchrl_atr.comparison.report import write_comparison
from torchrl_atr.comparison.scores import Scores, score
from torchrl_atr.comparison.study import AS_TRAINED, TRUTH, Outcome, Study
from torchrl_atr.comparison.summary import summarize

__all__ = [
    "AS_TRAINED",
    "QUICK",
    "TRUTH",
    "CompareOptions",
    "ComparisonError",
    "Outcome",
    "Recording",
    "Scores",
    "Study",
    "load_recording",
    "record",
    "score",
    "summarize",
    "write_comparison",
]

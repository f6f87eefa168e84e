"""Losses and schedules: PPO with regularised online adaptation (Eqs. 15-16), distillation of a teacher."""

from torchrl_atr.objectives.distillation import DistillationLoss
from torchrl_atr.objectives.regression import regression
from torchrl_atr.objectives.roa import ROAClipPPOLoss
from torchrl_atr.objectives.schedules import DeviceKLAdaptiveLR, LinearSchedule
from torchrl_atr.objectives.smoothness import previous_means

__all__ = [
    "DeviceKLAdaptiveLR",
    "DistillationLoss",
    "LinearSchedule",
    "ROAClipPPOLoss",
    "previous_means",
    "regression",
]

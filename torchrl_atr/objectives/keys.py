"""Keys of the loss with regularised online adaptation."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import NestedKey
from torchrl.objectives import ClipPPOLoss


@dataclass
class ROAKeys(ClipPPOLoss._AcceptedKeys):
    """Keys of ClipPPOLoss and those of the regression terms; all can be changed with ``set_keys``.

    Attributes:
        latent (NestedKey): what the encoder writes.
        latent_estimate (NestedKey): what the intrinsic estimator writes, and where a recorded zhat is read.
        extrinsic (NestedKey): the true extrinsic state in the data.
        extrinsic_estimate (NestedKey): what the extrinsic estimator writes.
        latent_estimate_scale, extrinsic_estimate_scale (NestedKey): standard deviations that estimators may write.
        previous_mean (NestedKey): the mean action of the step before, (*B, A).
        teacher_mean (NestedKey): the mean action of a teacher, (*B, A), which
            :class:`~torchrl_atr.objectives.DistillationLoss` imitates.
    """

    latent: NestedKey = ("latent", "intrinsic")
    latent_estimate: NestedKey = ("estimate", "intrinsic")
    extrinsic: NestedKey = ("privileged", "extrinsic")
    extrinsic_estimate: NestedKey = ("estimate", "extrinsic")
    latent_estimate_scale: NestedKey = ("estimate", "intrinsic_scale")
    extrinsic_estimate_scale: NestedKey = ("estimate", "extrinsic_scale")
    previous_mean: NestedKey = "previous_mean"
    teacher_mean: NestedKey = "teacher_mean"

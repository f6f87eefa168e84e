"""Estimator that also tells how sure it is: mean and standard deviation of every component, trained by likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tensordict.nn import TensorDictSequential

from torchrl_atr.modules.estimators.parts import EstimateHead, WindowFeatures
from torchrl_atr.modules.estimators.registry import register_estimator
from torchrl_atr.modules.estimators.spec import EstimatorSpec


@register_estimator("gaussian")
class GaussianEstimator(TensorDictSequential):
    """Mean and standard deviation of every component, from the features of any estimator of histories.

    Args:
        spec (EstimatorSpec): role and sizes.
        trunk (str): the estimator that makes the features. Defaults to ``cnn_gru``.
        features (int): number of features. Defaults to 64.
        cells (sequence of int): hidden widths of the head. Defaults to none.
        **arguments: of the trunk.

    Example:
        >>> GaussianEstimator(EstimatorSpec("extrinsic", (4, 5), {"extrinsic": 3}), trunk="mlp").in_keys
        ['history']
    """

    def __init__(
        self,
        spec: EstimatorSpec,
        trunk: str = "cnn_gru",
        features: int = 64,
        cells: Sequence[int] = (),
        **arguments: Any,
    ) -> None:
        super().__init__(
            WindowFeatures(spec, trunk, features, **arguments), EstimateHead(spec, features, cells, scale=True)
        )

"""Parts that estimators of a spec are composed of: features of a window, and the head that writes the estimates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tensordict import NestedKey
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import Tensor, nn
from torchrl.modules import MLP

from torchrl_atr.modules.estimators.normalized import beside
from torchrl_atr.modules.estimators.registry import get_estimator
from torchrl_atr.modules.estimators.spec import EstimatorSpec

LEAST_SCALE = 1e-3
"""Least standard deviation of an estimate, in those of its target."""


class WindowFeatures(TensorDictModule):
    """Features of the window, by a registered estimator of histories.

    Args:
        spec (EstimatorSpec): role and sizes.
        trunk (str): name of the estimator. Defaults to ``cnn_gru``.
        features (int): number of features. Defaults to 64.
        out_key (NestedKey): the output, (*B, features). Defaults to ``features``.
        **arguments: of that estimator.

    Example:
        >>> WindowFeatures(EstimatorSpec("extrinsic", (4, 5), {"extrinsic": 3}), "mlp").in_keys
        ['history']
    """

    def __init__(
        self,
        spec: EstimatorSpec,
        trunk: str = "cnn_gru",
        features: int = 64,
        out_key: NestedKey = "features",
        **arguments: Any,
    ) -> None:
        net = get_estimator(trunk)(history_shape=spec.window_shape, out_features=features, **arguments)
        super().__init__(_Features(net), in_keys=[spec.keys.history, *spec.inputs], out_keys=[out_key])


class _Features(nn.Module):
    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, history: Tensor, *inputs: Tensor) -> Tensor:
        return nn.functional.elu(self.net(beside(history, inputs)))


class EstimateHead(TensorDictModule):
    """MLP from features to all estimates of a role, with or without their standard deviations.

    Args:
        spec (EstimatorSpec): role and sizes.
        in_features (int): number of features.
        cells (sequence of int): hidden widths. Defaults to none: a linear map.
        scale (bool): whether it writes a Gaussian's standard deviations beside the means. Defaults to False.
        in_key (NestedKey): the features. Defaults to ``features``.

    Example:
        >>> EstimateHead(EstimatorSpec("extrinsic", (4, 5), {"extrinsic": 3}), 64, scale=True).out_keys
        [('estimate', 'extrinsic'), ('estimate', 'extrinsic_scale')]
    """

    def __init__(
        self,
        spec: EstimatorSpec,
        in_features: int,
        cells: Sequence[int] = (),
        scale: bool = False,
        in_key: NestedKey = "features",
    ) -> None:
        out_features = spec.out_features * (2 if scale else 1)
        net = MLP(in_features, out_features, num_cells=list(cells), activation_class=nn.ELU)
        head = _Head(net, list(spec.targets.values()), NormalParamExtractor(scale_lb=LEAST_SCALE) if scale else None)
        super().__init__(head, in_keys=[in_key], out_keys=[*spec.estimate_keys, *(spec.scale_keys if scale else [])])


class _Head(nn.Module):
    def __init__(self, net: nn.Module, sizes: list[int], extract: nn.Module | None) -> None:
        super().__init__()
        self.net, self.sizes, self.extract = net, sizes, extract

    def forward(self, features: Tensor) -> tuple[Tensor, ...]:
        out = self.net(features)
        parts = [out] if self.extract is None else self.extract(out)
        return tuple(piece for part in parts for piece in part.split(self.sizes, -1))

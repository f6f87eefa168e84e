"""Estimators that also tell how sure they are: mean and standard deviation of each component, trained by likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn

from torchrl_atr._checks import check_whole
from torchrl_atr.modules.estimators.normalized import beside
from torchrl_atr.modules.estimators.parts import LEAST_SCALE, EstimateHead, WindowFeatures
from torchrl_atr.modules.estimators.registry import get_estimator, register_estimator
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


@register_estimator("ensemble")
class EnsembleEstimator(TensorDictModule):
    """Mean of several estimators of histories; their spread tells how sure it is.

    The variance of a component is that of the members' estimates and of a noise, which is learned and the same
    everywhere: what no member could know. Members share nothing, so that they agree where they were trained and part
    elsewhere. They are trained together, by the likelihood of their mean.

    Args:
        spec (EstimatorSpec): role and sizes.
        trunk (str): the estimator that each member is. Defaults to ``mlp``.
        members (int): number of them, 2 or more. Defaults to 5.
        **arguments: of the trunk.

    Raises:
        InputError: for fewer than two members.

    Example:
        >>> ensemble = EnsembleEstimator(EstimatorSpec("extrinsic", (4, 5), {"extrinsic": 3}), members=3)
        >>> ensemble.out_keys
        [('estimate', 'extrinsic'), ('estimate', 'extrinsic_scale')]
    """

    def __init__(self, spec: EstimatorSpec, trunk: str = "mlp", members: int = 5, **arguments: Any) -> None:
        factory, count = get_estimator(trunk), check_whole("members", members, low=2)
        nets = [
            factory(history_shape=spec.window_shape, out_features=spec.out_features, **arguments) for _ in range(count)
        ]
        super().__init__(
            _Ensemble(nets, list(spec.targets.values())),
            in_keys=[spec.keys.history, *spec.inputs],
            out_keys=[*spec.estimate_keys, *spec.scale_keys],
        )


class _Ensemble(nn.Module):
    def __init__(self, members: Sequence[nn.Module], sizes: list[int]) -> None:
        super().__init__()
        self.members, self.sizes = nn.ModuleList(members), sizes
        self.noise = nn.Parameter(torch.zeros(sum(sizes)))

    def forward(self, history: Tensor, *inputs: Tensor) -> tuple[Tensor, ...]:
        window = beside(history, inputs)
        estimates = torch.stack([member(window) for member in self.members])
        noise = nn.functional.softplus(self.noise) + LEAST_SCALE
        scale = (estimates.var(0) + noise.square()).sqrt()
        return *estimates.mean(0).split(self.sizes, -1), *scale.split(self.sizes, -1)

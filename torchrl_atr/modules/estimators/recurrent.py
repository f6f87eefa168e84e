"""Estimator with a memory: a GRU whose hidden state is carried from step to step through the whole episode."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.modules import MLP, GRUModule

from torchrl_atr.modules.estimators.parts import EstimateHead
from torchrl_atr.modules.estimators.registry import register_estimator
from torchrl_atr.modules.estimators.spec import EstimatorSpec


@register_estimator("gru")
class RecurrentEstimator(TensorDictSequential):
    """GRU over the episode: it reads one observation at a time and no history, and is trained on sequences.

    Args:
        spec (EstimatorSpec): role and sizes.
        features (int): width of the GRU and of what it reads. Defaults to 64.
        cells (sequence of int): hidden widths of the head. Defaults to ``(128,)``.

    Example:
        >>> RecurrentEstimator(EstimatorSpec("extrinsic", (10, 46), {"extrinsic": 16})).in_keys
        ['observation', 'extrinsic_estimator_state', 'is_init']
    """

    def __init__(self, spec: EstimatorSpec, features: int = 64, cells: Sequence[int] = (128,)) -> None:
        reads = [spec.keys.observation, *spec.inputs]
        embed = MLP(spec.window_shape[1], features, num_cells=[], activate_last_layer=True, activation_class=nn.ELU)
        super().__init__(
            TensorDictModule(embed, in_keys=reads, out_keys=["embedding"]),
            GRUModule(
                features,
                features,
                in_keys=["embedding", spec.state_key],
                out_keys=["features", spec.next_state_key],
            ),
            EstimateHead(spec, features, cells),
        )

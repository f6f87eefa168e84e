"""Example of a custom estimator with a memory, a loss of its own and standard deviations.

python examples/own_memory.py
torchrl-atr train --import examples.own_memory --estimator predictive_gru --max-minutes 5 --output runs/memory
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor
from torchrl.modules import MLP, GRUModule

from torchrl_atr.modules import EstimateHead, EstimatorSpec, check_estimator, register_estimator


@register_estimator("predictive_gru")
class PredictiveGRU(TensorDictSequential):
    """GRU over the episode that also predicts the next observation, and says how sure its estimates are."""

    def __init__(self, spec: EstimatorSpec, width: int = 64, coeff: float = 0.5) -> None:
        embedding = MLP(spec.window_shape[1], width, num_cells=[], activate_last_layer=True)  # concatenates its inputs
        super().__init__(
            TensorDictModule(embedding, in_keys=[spec.keys.observation, *spec.inputs], out_keys=["embedding"]),
            GRUModule(
                width,
                width,
                in_keys=["embedding", spec.state_key],  # and "is_init", where episodes begin
                out_keys=["features", spec.next_state_key],  # carried to the next step by TorchRL's primer
            ),
            EstimateHead(spec, width, cells=[128], scale=True),  # means and standard deviations of the role's targets
        )
        self.predictor = MLP(width, spec.observation_features, num_cells=[64])
        self.coeff = coeff
        self.loss_in_keys = [spec.next_observation_key]  # known in training alone

    def losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return the error of the predicted observation for each step; all that forward wrote is there."""
        error = self.predictor(tensordict["features"]) - tensordict[self.loss_in_keys[0]]
        return {"prediction": self.coeff * error.square().mean(-1)}


if __name__ == "__main__":
    torch.manual_seed(0)
    for role in ("intrinsic", "extrinsic", "both"):
        check_estimator(PredictiveGRU, history_shape=(10, 46), out_features=16, role=role)
        print(f"predictive_gru, {role}: conforms")

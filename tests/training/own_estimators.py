"""Estimators from outside the package, one of each kind; sizes are tiny."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.modules import GRUModule

from torchrl_atr.modules import EstimateHead, EstimatorSpec, WindowFeatures


class Window(nn.Module):
    """(a) A network of a window."""

    def __init__(self, history_shape, out_features):
        super().__init__()
        self.net = nn.Linear(history_shape[0] * history_shape[1], out_features)

    def forward(self, history):
        return self.net(history.flatten(-2))


class Memory(TensorDictSequential):
    """(b) A hidden state, by TorchRL's GRUModule."""

    def __init__(self, spec: EstimatorSpec):
        features = spec.observation_features
        super().__init__(
            GRUModule(
                features, 4, in_keys=[spec.keys.observation, spec.state_key], out_keys=["features", spec.next_state_key]
            ),
            EstimateHead(spec, 4),
        )


class Predicts(TensorDictModuleBase):
    """(c) A loss of its own: the next observation, with noise on the features that only the loss has."""

    def __init__(self, spec: EstimatorSpec):
        super().__init__()
        self.features, self.head = WindowFeatures(spec, "mlp", 4, cells=[4]), EstimateHead(spec, 4)
        self.predict = nn.Linear(4, spec.observation_features)
        self.in_keys, self.out_keys = self.features.in_keys, self.head.out_keys
        self.loss_in_keys = [spec.next_observation_key]

    def forward(self, tensordict):
        return self.head(self.features(tensordict))

    def losses(self, tensordict):
        features = tensordict["features"]
        predicted = self.predict(features + 0.1 * torch.randn_like(features))
        return {"prediction": (predicted - tensordict[self.loss_in_keys[0]]).square().mean(-1)}


class Unsure(TensorDictModule):
    """(d) Mean and standard deviation."""

    def __init__(self, spec: EstimatorSpec):
        sizes = list(spec.targets.values())
        super().__init__(
            _MeanAndScale(spec.history_shape, sizes),
            in_keys=[spec.keys.history],
            out_keys=[*spec.estimate_keys, *spec.scale_keys],
        )


class _MeanAndScale(nn.Module):
    def __init__(self, shape, sizes):
        super().__init__()
        self.sizes = sizes
        self.net = nn.Linear(shape[0] * shape[1], 2 * sum(sizes))

    def forward(self, history):
        mean, scale = self.net(history.flatten(-2)).chunk(2, -1)
        return (*mean.split(self.sizes, -1), *(nn.functional.softplus(scale) + 1e-3).split(self.sizes, -1))


KINDS = {"window": Window, "memory": Memory, "predicts": Predicts, "unsure": Unsure}

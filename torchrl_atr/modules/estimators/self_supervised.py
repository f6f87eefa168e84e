"""Estimators that also learn from what follows: by reconstructing the next observation, or by contrast with it."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import NormalParamExtractor, TensorDictModuleBase
from torch import Tensor, nn
from torch.distributions import Normal, kl_divergence
from torchrl.modules import MLP

from torchrl_atr.modules.estimators.parts import EstimateHead, WindowFeatures
from torchrl_atr.modules.estimators.registry import register_estimator
from torchrl_atr.modules.estimators.spec import EstimatorSpec


@register_estimator("variational")
class VariationalEstimator(TensorDictModuleBase):
    """Variational autoencoder from the window to the next observation; its mean code makes the estimate.

    The idea of DreamWaQ (https://arxiv.org/abs/2301.10602). Only its loss samples: estimates are deterministic.

    Args:
        spec (EstimatorSpec): role and sizes.
        trunk (str): estimator that makes the features. Defaults to ``cnn_gru``.
        features (int): number of features. Defaults to 64.
        code (int): size of the code. Defaults to 16.
        coeff (float): weight of both losses. Defaults to 1.
        kl_coeff (float): weight of the divergence from the prior, beside the squared error. Defaults to 0.01.
        **arguments: of the trunk.

    Example:
        >>> VariationalEstimator(EstimatorSpec("extrinsic", (4, 5), {"extrinsic": 3}), trunk="mlp").loss_in_keys
        [('next', 'observation')]
    """

    def __init__(
        self,
        spec: EstimatorSpec,
        trunk: str = "cnn_gru",
        features: int = 64,
        code: int = 16,
        coeff: float = 1.0,
        kl_coeff: float = 0.01,
        **arguments: Any,
    ) -> None:
        super().__init__()
        self.features = WindowFeatures(spec, trunk, features, **arguments)
        self.posterior = nn.Sequential(nn.Linear(features, 2 * code), NormalParamExtractor(scale_lb=1e-3))
        self.head = EstimateHead(spec, code, in_key="code_mean")
        self.decoder = MLP(code, spec.observation_features, num_cells=[64, 128], activation_class=nn.ELU)
        self.coeff, self.kl_coeff = coeff, kl_coeff
        self.in_keys, self.out_keys = list(self.features.in_keys), list(self.head.out_keys)
        self.loss_in_keys = [spec.next_observation_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the estimates, and the code's mean and standard deviation."""
        mean, std = self.posterior(self.features(tensordict)["features"])
        return self.head(tensordict.set("code_mean", mean).set("code_std", std))

    def losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return the squared error of the next observation, and the divergence of the code from its prior."""
        code = Normal(tensordict["code_mean"], tensordict["code_std"], validate_args=False)  # it would wait for a GPU
        error = self.decoder(code.rsample()) - tensordict[self.loss_in_keys[0]]
        prior = Normal(torch.zeros_like(code.loc), torch.ones_like(code.scale), validate_args=False)
        return {
            "reconstruction": self.coeff * error.square().mean(-1),
            "kl": self.coeff * self.kl_coeff * kl_divergence(code, prior).sum(-1),
        }


@register_estimator("contrastive")
class ContrastiveEstimator(TensorDictModuleBase):
    """Features of the window that tell which next observation belongs to it; a linear map of them is the estimate.

    The idea of HIM (https://arxiv.org/abs/2312.11460): window and next observation are assigned to the same of a few
    learned prototypes, each predicting the other's assignment (SwAV, https://arxiv.org/abs/2006.09882).

    Args:
        spec (EstimatorSpec): role and sizes.
        trunk (str): estimator that makes the features. Defaults to ``cnn_gru``.
        features (int): number of features. Defaults to 64.
        embedding (int): size of the space of the prototypes. Defaults to 16.
        prototypes (int): number of them. Defaults to 32.
        temperature (float): of the predicted assignment. Defaults to 0.2.
        coeff (float): weight of the loss. Defaults to 1.
        **arguments: of the trunk.

    Example:
        >>> ContrastiveEstimator(EstimatorSpec("extrinsic", (4, 5), {"extrinsic": 3}), trunk="mlp").loss_in_keys
        [('next', 'observation')]
    """

    def __init__(
        self,
        spec: EstimatorSpec,
        trunk: str = "cnn_gru",
        features: int = 64,
        embedding: int = 16,
        prototypes: int = 32,
        temperature: float = 0.2,
        coeff: float = 1.0,
        **arguments: Any,
    ) -> None:
        super().__init__()
        self.features = WindowFeatures(spec, trunk, features, **arguments)
        self.head = EstimateHead(spec, features)
        self.of_window = nn.Linear(features, embedding)
        self.of_next = MLP(spec.observation_features, embedding, num_cells=[64], activation_class=nn.ELU)
        self.prototypes = nn.Parameter(torch.randn(prototypes, embedding))
        self.temperature, self.coeff = temperature, coeff
        self.in_keys, self.out_keys = list(self.features.in_keys), list(self.head.out_keys)
        self.loss_in_keys = [spec.next_observation_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the estimates and the features."""
        return self.head(self.features(tensordict))

    def losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return the cross-entropy of each side's assignment, as the other predicts it."""
        window = self._scores(self.of_window(tensordict["features"]))
        following = self._scores(self.of_next(tensordict[self.loss_in_keys[0]]))
        swapped = _cross_entropy(window, following, self.temperature) + _cross_entropy(
            following, window, self.temperature
        )
        return {"contrast": 0.5 * self.coeff * swapped}

    def _scores(self, embedding: Tensor) -> Tensor:
        """Return the cosines with all prototypes, (*B, K)."""
        return nn.functional.normalize(embedding, dim=-1) @ nn.functional.normalize(self.prototypes, dim=-1).T


def _cross_entropy(predicting: Tensor, assigned: Tensor, temperature: float) -> Tensor:
    return -(balanced_assignment(assigned) * (predicting / temperature).log_softmax(-1)).sum(-1)


@torch.no_grad()
def balanced_assignment(scores: Tensor, iterations: int = 3, temperature: float = 0.05) -> Tensor:
    """Return soft assignments of a batch to prototypes that are all used alike (Sinkhorn-Knopp), (*B, K).

    Args:
        scores: (*B, K).
        iterations: of the normalisation of columns and rows in turn.
        temperature: the lower, the harder the assignments.

    Example:
        >>> balanced_assignment(torch.eye(2)).round(decimals=3).tolist()
        [[1.0, 0.0], [0.0, 1.0]]
    """
    log = scores.flatten(0, -2) / temperature
    for _ in range(iterations):
        log = log - log.logsumexp(0, keepdim=True)
        log = log - log.logsumexp(1, keepdim=True)
    return log.exp().reshape(scores.shape)

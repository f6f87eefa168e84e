"""Gaussian actions with noise that is correlated over legs and time, for exploration in rollouts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torch.distributions import Normal, kl_divergence, register_kl
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import IndependentNormal, ProbabilisticActor

from torchrl_atr._inference import keeps_normal_tensors
from torchrl_atr.modules.keys import log_prob_key


class RotatedNormal(IndependentNormal):
    """Normal distribution of actions that is independent along the columns of an orthonormal basis.

    Args:
        loc (Tensor): mean action, (*B, A).
        scale (Tensor): standard deviation along each column, (*B, A).
        basis (Tensor, optional): (A, A); None for the actions themselves.

    Example:
        >>> from torchrl_atr.modules import hadamard_leg_basis
        >>> normal = RotatedNormal(torch.zeros(12), torch.full((12,), 0.1), hadamard_leg_basis())
        >>> normal.rsample().shape, normal.log_prob(torch.zeros(12)).shape
        (torch.Size([12]), torch.Size([]))
    """

    def __init__(self, loc: Tensor, scale: Tensor, basis: Tensor | None = None, **kwargs: Any) -> None:
        self.basis = None if basis is None else basis.to(loc)
        super().__init__(loc, scale, **kwargs)

    def rsample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Draw actions, (*sample_shape, *B, A)."""
        loc = self.base_dist.loc
        return self.displace(torch.randn(*sample_shape, *loc.shape, dtype=loc.dtype, device=loc.device))

    def sample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Draw actions without gradient, (*sample_shape, *B, A)."""
        with torch.no_grad():
            return self.rsample(sample_shape)

    def displace(self, noise: Tensor) -> Tensor:
        """Return the action for a standard normal ``noise`` along the columns, (*B, A)."""
        deviation = self.base_dist.scale * noise
        return self.base_dist.loc + (deviation if self.basis is None else deviation @ self.basis.T)

    def log_prob(self, value: Tensor) -> Tensor:
        """Return the log-density of ``value`` (*B, A), as (*B,)."""
        loc = self.base_dist.loc
        return super().log_prob(value if self.basis is None else loc + (value - loc) @ self.basis)

    @property
    def variance(self) -> Tensor:
        """Variance of each action, (*B, A): the diagonal of B diag(scale²) Bᵀ for the basis B."""
        along = self.base_dist.variance
        return along if self.basis is None else along @ self.basis.square().T

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> RotatedNormal:
        """Return the distribution of a larger batch, without copies."""
        loc, scale = self.base_dist.loc, self.base_dist.scale
        shape = (*batch_shape, loc.shape[-1])
        return type(self)(loc.expand(shape), scale.expand(shape), self.basis)


@register_kl(RotatedNormal, RotatedNormal)
def _kl(p: RotatedNormal, q: RotatedNormal) -> Tensor:
    bases = [each.basis for each in (p, q) if each.basis is not None]
    if len(bases) == 1 or (bases and not torch.equal(*bases)):
        raise NotImplementedError("RotatedNormals of two bases have no KL divergence here; give both the same basis")
    along = [
        Normal(each.base_dist.loc if p.basis is None else each.base_dist.loc @ p.basis, each.base_dist.scale)
        for each in (p, q)
    ]
    return kl_divergence(*along).sum(-1)


class CorrelatedGaussian(TensorDictModuleBase):
    """Sampler of actions loc + scale · ε with ε_t = ρ ε_{t-1} + √(1 - ρ²) ξ_t, for rollouts of a batched env.

    At every step the action has the policy's own marginal distribution, and its log-probability is that of
    the marginal: a loss that recomputes it finds an importance ratio of one. But a deviation lasts for
    1 / (1 - ρ) steps, long enough to lean, tilt the board and turn; white noise at 50 Hz averages out
    before the board responds. The noise continues through resets.

    Args:
        correlation (float): ρ in [0, 1); 0 is white noise.
        basis (Tensor, optional): of the policy's :class:`RotatedNormal`.
        loc, scale (NestedKey): the policy's mean and standard deviation, (*B, A).
        action (NestedKey): the output, with ``<action>_log_prob`` beside it.

    Raises:
        ValueError: unless ``0 <= correlation < 1``.

    Example:
        >>> from tensordict import TensorDict
        >>> explore = CorrelatedGaussian(0.9)
        >>> td = explore(TensorDict(loc=torch.zeros(4, 2), scale=torch.ones(4, 2), batch_size=[4]))
        >>> td["action"].shape, td["action_log_prob"].shape
        (torch.Size([4, 2]), torch.Size([4]))
    """

    def __init__(
        self,
        correlation: float,
        *,
        basis: Tensor | None = None,
        loc: NestedKey = "loc",
        scale: NestedKey = "scale",
        action: NestedKey = "action",
    ) -> None:
        super().__init__()
        if not 0.0 <= correlation < 1.0:
            raise ValueError(f"correlation must be in [0, 1), got {correlation}; 0 is white noise.")
        self.correlation = float(correlation)
        self.register_buffer("basis", basis, persistent=False)
        self._noise: Tensor | None = None
        self.in_keys = [loc, scale]
        self.out_keys = [action, log_prob_key(action)]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action and its log-probability; the mean under ``ExplorationType.DETERMINISTIC``."""
        loc, scale = (tensordict.get(key) for key in self.in_keys)
        normal = RotatedNormal(loc, scale, self.basis)
        action = loc
        if exploration_type() not in (ExplorationType.DETERMINISTIC, ExplorationType.MODE, ExplorationType.MEAN):
            action = normal.displace(self._next_noise(torch.randn_like(loc)))
        tensordict.set(self.out_keys[0], action)
        return tensordict.set(self.out_keys[1], normal.log_prob(action))

    @keeps_normal_tensors
    def _next_noise(self, fresh: Tensor) -> Tensor:
        if self._noise is None or self._noise.shape != fresh.shape:
            self._noise = fresh.clone()
            return fresh
        self._noise = self._noise.to(fresh)  # a checkpoint is loaded on the CPU
        noise = self.correlation * self._noise + math.sqrt(1 - self.correlation**2) * fresh
        self._noise.copy_(noise)  # in place: a captured step reads the same buffer again
        return noise

    def get_extra_state(self) -> dict[str, Any]:
        """Return the current noise, (*B, A), or None before the first step."""
        return {"noise": None if self._noise is None else self._noise.clone()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`."""
        noise = state["noise"]
        self._noise = None if noise is None else noise.clone()


def with_correlated_noise(actor: ProbabilisticActor, correlation: float) -> TensorDictSequential:
    """Replace an actor's sampling by :class:`CorrelatedGaussian`; the networks stay shared.

    Args:
        actor (ProbabilisticActor): a Gaussian policy that writes ``loc`` and ``scale``, such as
            :func:`~torchrl_atr.modules.make_actor`'s, or under other keys.
        correlation (float): ρ in [0, 1).

    Returns:
        TensorDictSequential: the policy for a collector.

    Example:
        >>> from torchrl_atr.modules import ActorBackbone, Exploration, RunningNormalizer, make_actor
        >>> actor = make_actor(ActorBackbone(RunningNormalizer(5), RunningNormalizer(4), 3, 2), Exploration(2))
        >>> with_correlated_noise(actor, 0.9).in_keys
        ['observation', ('act', 'intrinsic'), ('act', 'extrinsic')]
    """
    *networks, sampler = actor.module
    basis = sampler.distribution_kwargs.get("basis")
    read = {key if isinstance(key, str) else key[-1]: at for key, at in zip(sampler.dist_keys, sampler.in_keys)}
    keys = {"loc": read["loc"], "scale": read["scale"], "action": sampler.out_keys[0]}
    return TensorDictSequential(*networks, CorrelatedGaussian(correlation, basis=basis, **keys))

"""What the losses here need of TorchRL's ClipPPOLoss beyond its public interface, in one place."""

from __future__ import annotations

import contextlib
from contextlib import AbstractContextManager
from typing import Any

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import CompositeDistribution, ProbabilisticTensorDictSequential, TensorDictModule, TensorDictParams
from torch import Tensor
from torch.distributions import Distribution
from torchrl.modules.distributions.utils import has_analytic_entropy
from torchrl.objectives import ClipPPOLoss


class ExtensibleClipPPOLoss(ClipPPOLoss):
    """Let a subclass add terms to clipped PPO: of further networks, and of what the actor computes, in one pass of it.

    A subclass calls :meth:`_act`, then the terms of PPO and its own on the result::

        acted = self._act(tensordict)
        out = super().forward(acted)
        mean = self._distribution(acted).mean

    Private methods of ClipPPOLoss that are replaced, and why:

    =====================  ========================================================================================
    ``_get_cur_log_prob``  would run the actor; here it has run, and its distribution is that of what it wrote
    ``_get_entropy``       looks whether a closed form is finite, which waits for a GPU; here it is taken as it is
    =====================  ========================================================================================

    Args:
        actor_network (ProbabilisticTensorDictSequential): networks, then one probabilistic module.
        critic_network (TensorDictModule): the critic.
        **ppo_kwargs: passed to :class:`~torchrl.objectives.ClipPPOLoss`.

    Raises:
        TypeError: if the actor is none, or samples in more than one module.
    """

    def __init__(
        self, actor_network: ProbabilisticTensorDictSequential, critic_network: TensorDictModule, **ppo_kwargs: Any
    ) -> None:
        composite = getattr(actor_network, "return_composite", False)
        if not isinstance(actor_network, ProbabilisticTensorDictSequential) or composite:
            raise TypeError(
                "actor_network must be a ProbabilisticTensorDictSequential whose last module alone samples, such as a "
                f"ProbabilisticActor; got {type(actor_network).__name__}."
            )
        super().__init__(actor_network, critic_network, **ppo_kwargs)

    def _act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return a copy of ``tensordict`` with what the actor's networks write, with gradients; nothing is sampled."""
        with self._parameters_of("actor_network"):
            return self.actor_network.get_dist_params(tensordict.copy())

    def _distribution(self, acted: TensorDictBase) -> Distribution:
        """Return the policy's distribution from what :meth:`_act` returned; no network runs."""
        return self.actor_network.build_dist_from_params(acted)

    def _get_cur_log_prob(
        self, tensordict: TensorDictBase, params: TensorDictParams | None = None
    ) -> tuple[Any, Distribution, bool]:
        if params is not None:  # of the proximal policy of delay_actor
            return super()._get_cur_log_prob(tensordict, params)
        dist, keys = self._distribution(tensordict), self.tensor_keys.action
        composite = isinstance(dist, CompositeDistribution)
        action = tensordict.select(*(keys if isinstance(keys, list) else [keys])) if composite else tensordict.get(keys)
        if action.requires_grad:
            raise RuntimeError(f"The stored {keys!r} requires grad; collect it under torch.no_grad().")
        return dist.log_prob(action), dist, composite

    def _get_entropy(self, dist: Distribution, adv_shape: Any) -> Any:
        return dist.entropy().unsqueeze(-1) if has_analytic_entropy(dist) else super()._get_entropy(dist, adv_shape)

    def _add_network(self, name: str, network: TensorDictModule) -> None:
        """Hold a further network as the actor and the critic are held, functional or not."""
        if self.functional:
            self.convert_to_functional(network, name)
        else:
            setattr(self, name, network)
            setattr(self, f"{name}_params", None)
            setattr(self, f"target_{name}_params", None)

    def _run(self, name: str, key: NestedKey, tensordict: TensorDictBase, remedy: str) -> Tensor:
        """Return ``key`` as a network writes it, run on its own inputs only: nothing that was recorded is overwritten.

        Args:
            name: under which it was added.
            key: of the entry.
            tensordict: holds its inputs.
            remedy: what to do if it does not write the entry.

        Raises:
            KeyError: if an input is missing, or it does not write the entry.
        """
        network = getattr(self, name)
        try:
            inputs = tensordict.select(*network.in_keys)
        except KeyError as error:
            raise KeyError(f"{name} reads {network.in_keys}, not all of which are in the data: keep them") from error
        with self._parameters_of(name):
            out = network(inputs).get(key, None)
        if out is None:
            raise KeyError(f"{name} did not write {key!r}; it writes {network.out_keys}. {remedy}")
        return out

    def _parameters_of(self, name: str) -> AbstractContextManager[Any]:
        """Return a context in which a network has its parameters, which a functional loss holds apart from it."""
        params = getattr(self, f"{name}_params")
        if params is None:
            return contextlib.nullcontext()
        return params.to_module(getattr(self, name), preserve_module_state=False)

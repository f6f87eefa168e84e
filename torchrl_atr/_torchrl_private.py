"""All private names of TorchRL that the package relies on, and the purpose of each.

``tests/test_torchrl_private.py`` has a test for each, which fails when TorchRL renames it or calls it elsewhere.

==============================================  =======================================================================
private name of TorchRL 0.14                    used by, for
==============================================  =======================================================================
``Collector._carrier``                          :func:`carried_root`: ``Collector.state_dict`` leaves out the root of
                                                the next step, without which a run would not resume bit for bit
``Transform._container``                        :func:`env_around`: ``Transform.container`` is public, and fails while
                                                transforms are being put together
``ParallelEnv._seeds``, ``SerialEnv._envs``     :func:`parallel_seeds`, :func:`serial_envs`: ``set_seed`` does not reach
                                                transforms, and batched envs do not tell the seed that they were given
``Transform._post_step_mdp_hooks``              :class:`AfterStepTransform`: the one point where both the step and the
                                                root of the next are at hand
``Transform._check_batched_worker_compat``      :class:`AfterStepTransform`: a ``ParallelEnv`` does not call that hook
                                                of its workers' transforms
``LossModule._all_schedulable_buffers``         :func:`schedulable_buffers`: names of the coefficients that may be set
``LossModule._reduce_loss``                     :class:`ExtensibleClipPPOLoss`: means that honour masks
``LossModule._loss_mask_keys``                  the same: entries that minibatches must keep
``PPOLoss._get_cur_log_prob``                   the same: it would run the actor, which has run
``PPOLoss._get_entropy``                        the same: it looks whether a closed form is finite, and waits for a GPU
``PPOLoss._set_in_keys, _in_keys, _out_keys``   the same: keys of what a subclass adds
==============================================  =======================================================================

Not in the list is what TorchRL documents for subclasses: ``EnvBase._reset``, ``_step``, ``_set_seed``;
``Transform._reset``, ``_step``, ``_call``, ``_reset_env_preprocess``; ``LossModule._AcceptedKeys``,
``_schedulable_buffers``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import CompositeDistribution, ProbabilisticTensorDictSequential, TensorDictModule, TensorDictParams
from torch import Tensor
from torch.distributions import Distribution
from torchrl.collectors import BaseCollector
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv
from torchrl.envs.transforms import Transform
from torchrl.modules import set_recurrent_mode
from torchrl.modules.distributions.utils import has_analytic_entropy
from torchrl.objectives import ClipPPOLoss, LossModule


def carried_root(collector: BaseCollector) -> TensorDictBase:
    """Return the root of the next step of a collector of this process, which it steps from and updates in place."""
    return collector._carrier


def env_around(transform: Transform) -> EnvBase | None:
    """Return the env that a transform is attached to, through any ``Compose``; None if there is none."""
    around: Any = transform
    while isinstance(around, Transform):
        reference = around.__dict__.get("_container")
        around = None if reference is None else reference()
    return around


def parallel_seeds(env: ParallelEnv) -> list[int] | None:
    """Return the seeds that a ParallelEnv was last given, a new list at every ``set_seed``; None before the first."""
    return env.__dict__.get("_seeds")


def serial_envs(env: SerialEnv) -> Sequence[EnvBase]:
    """Return the envs of a SerialEnv; empty before it has started."""
    return env.__dict__.get("_envs") or ()


def schedulable_buffers(loss: LossModule) -> list[str]:
    """Return the names of a loss's coefficients that may be set while it trains, sorted."""
    buffers = dict(loss.named_buffers(recurse=False))
    return sorted(name for name in type(loss)._all_schedulable_buffers if name in buffers)


class AfterStepTransform(Transform):
    """Transform of each step and of the root of the next one; a subclass overrides :meth:`after_step`."""

    worker_error = "wrap the ParallelEnv or SerialEnv instead"

    def after_step(self, step: TensorDictBase, root: TensorDictBase) -> None:
        """Change a step, ``next`` included, and the root of the next step in place."""

    def _post_step_mdp_hooks(
        self, tensordict: TensorDictBase, tensordict_: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        self.after_step(tensordict, tensordict_)
        return tensordict, tensordict_

    def _check_batched_worker_compat(self) -> None:
        raise RuntimeError(f"{type(self).__name__} cannot be part of what a batched env runs: {self.worker_error}")


class ExtensibleClipPPOLoss(ClipPPOLoss):
    """Clipped PPO to which a subclass adds terms of further networks and of the actor's outputs, in one pass of it.

    A subclass calls :meth:`_act`, then the terms of PPO and its own on the result::

        acted = self._act(tensordict)
        out = super().forward(acted)
        mean = self._distribution(acted).mean

    It says with :meth:`further_in_keys` and :meth:`further_out_keys` what they read and write.

    Args:
        actor_network (ProbabilisticTensorDictSequential): networks, then one probabilistic module.
        critic_network (TensorDictModule): the critic.
        **ppo_kwargs: passed to :class:`~torchrl.objectives.ClipPPOLoss`.

    Raises:
        TypeError: if the actor is of another class, or samples in more than one module.
    """

    _in_keys: list[NestedKey] | None
    _out_keys: list[NestedKey] | None

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

    def further_in_keys(self) -> list[NestedKey]:
        """Return the entries that a subclass's terms read; also called while the parent's constructor runs."""
        return []

    def further_out_keys(self) -> list[NestedKey]:
        """Return the names of a subclass's terms."""
        return []

    def _set_in_keys(self) -> None:
        super()._set_in_keys()
        self._in_keys = list({*(self._in_keys or ()), *self.further_in_keys()})

    @property
    def out_keys(self) -> list[NestedKey]:
        """Keys of ClipPPOLoss and those of a subclass's terms."""
        if self._out_keys is None:
            self._out_keys = [*ClipPPOLoss.out_keys.fget(self), *self.further_out_keys()]  # type: ignore[attr-defined]
        return self._out_keys

    @out_keys.setter
    def out_keys(self, values: list[NestedKey]) -> None:
        self._out_keys = values

    def _renew_keys(self) -> None:
        """Forget the keys that the parent's constructor noted: what a subclass adds was not there yet."""
        self._in_keys = self._out_keys = None

    def _reduced(self, values: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Return the mean, or what ``reduction`` says, where the masks of ``tensordict`` are true."""
        return self._reduce_loss(values, tensordict)

    @property
    def _mask_keys(self) -> list[NestedKey]:
        """Keys of masks that the data may hold; minibatches keep them."""
        return list(self._loss_mask_keys())

    def _add_network(self, name: str, network: TensorDictModule) -> None:
        """Hold a further network as the actor and the critic are held, functional or not."""
        if self.functional:
            self.convert_to_functional(network, name)
        else:
            setattr(self, name, network)
            setattr(self, f"{name}_params", None)
            setattr(self, f"target_{name}_params", None)

    def _run(self, name: str, key: NestedKey, tensordict: TensorDictBase, remedy: str) -> Tensor:
        """Return ``key`` as a network writes it; see :meth:`_run_all`."""
        return self._run_all(name, tensordict, [key], remedy, losses=False)[0].get(key)

    def _run_all(
        self, name: str, tensordict: TensorDictBase, wanted: Sequence[NestedKey], remedy: str, losses: bool = True
    ) -> tuple[TensorDictBase, dict[str, Tensor]]:
        """Run a network on its own inputs only: nothing that was recorded is overwritten.

        A network with a hidden state, which writes entries of ``next``, runs over sequences.

        Args:
            name: under which it was added.
            tensordict: holds its inputs.
            wanted: entries that it must write.
            remedy: what to do if it does not.
            losses: whether to compute the network's own losses, if it has ``estimate_and_losses``.

        Returns:
            Its outputs, and those losses by name.

        Raises:
            KeyError: if an input is missing, or it does not write an entry.
            ValueError: if it has a hidden state, and the data are no sequences.
        """
        network = getattr(self, name)
        own = losses and hasattr(network, "estimate_and_losses")
        try:
            inputs = tensordict.select(*network.in_keys, *(network.loss_in_keys if own else ()))
        except KeyError as error:
            raise KeyError(f"{name} reads {network.in_keys}, not all of which are in the data: keep them") from error
        recurrent = any(isinstance(key, tuple) and key[0] == "next" for key in network.out_keys)
        if recurrent and tensordict.ndim < 2:
            raise ValueError(
                f"{name} has a hidden state, and the data are {tuple(tensordict.shape)}: give it sequences of steps in "
                "their order, (n, T), not shuffled steps"
            )
        over_time = set_recurrent_mode(True) if recurrent else contextlib.nullcontext()
        with self._parameters_of(name), over_time:
            out, terms = network.estimate_and_losses(inputs) if own else (network(inputs), {})
        for key in wanted:
            if out.get(key, None) is None:
                raise KeyError(f"{name} did not write {key!r}; it writes {network.out_keys}. {remedy}")
        return out, terms

    def _parameters_of(self, name: str) -> AbstractContextManager[Any]:
        """Return a context in which a network has its parameters, which a functional loss holds apart from it."""
        params = getattr(self, f"{name}_params")
        if params is None:
            return contextlib.nullcontext()
        return params.to_module(getattr(self, name), preserve_module_state=False)

"""Hook points of a run, at which user code is called during training."""

from __future__ import annotations

import io
import logging
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal

import torch
from tensordict import NestedKey, TensorDictBase

from torchrl_atr._checks import check_keys
from torchrl_atr._errors import InputError, first_line
from torchrl_atr._settings import ConfigError
from torchrl_atr.runs.checkpoint import CheckpointError

if TYPE_CHECKING:
    from torchrl_atr.training.trainer import Trainer

Phase = Literal["policy", "estimators"]
"""Networks that an optimiser step trains: actor, encoder and critic, or both estimators."""
_LOG = logging.getLogger(__name__)


class Callback:
    """Base class of code that a :class:`~torchrl_atr.training.Trainer` calls at fixed points; override what is needed.

    A method that is not overridden is never called. They replace the hooks of
    :meth:`torchrl.trainers.Trainer.register_op`, which only a TorchRL trainer calls: it has one loss and one
    optimisation stepper (policy and estimators learn in phases here), and its hooks cannot end a run.

    Attributes:
        in_keys: entries of the batch that :meth:`on_minibatch` or :meth:`on_loss` read; a minibatch otherwise holds
            what the loss reads.

    Example:
        >>> class Clip(Callback):
        ...     def on_batch(self, batch):
        ...         return batch.set(("next", "reward"), batch["next", "reward"].clamp(-1, 1))
        >>> Clip().name
        'Clip'
    """

    in_keys: Sequence[NestedKey] = ()

    @property
    def name(self) -> str:
        """Name of the callback in checkpoints and errors; two callbacks of a run must differ."""
        return type(self).__name__

    def on_train_begin(self, trainer: Trainer) -> None:
        """Prepare, workers started; ``trainer`` has ``env``, ``learner``, ``config``, ``run`` (TorchRL: ``setup``)."""

    def on_batch(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the batch to learn from, before metrics and advantages (TorchRL: ``batch_process``).

        Args:
            batch: (N, T), on the CPU. Entries can be set; the tensors themselves are the collector's and must not be
                changed in place.
        """
        return batch

    def on_minibatch(self, minibatch: TensorDictBase, phase: Phase) -> TensorDictBase:
        """Return what an optimiser step reads (TorchRL: ``process_optim_batch``).

        Args:
            minibatch: (B,), on the learner's device, with what the loss reads and :attr:`in_keys`. Entries can be set;
                the tensors are those of all epochs and must not be changed in place.
            phase: what the step trains.
        """
        return minibatch

    def on_loss(self, terms: TensorDictBase, minibatch: TensorDictBase, phase: Phase) -> TensorDictBase:
        """Return the terms of an optimiser step, scalars, from those that the loss computed of a minibatch.

        The sum of those called ``loss_...`` is minimised, all are logged (TorchRL: ``process_loss``). On a GPU it needs
        ``compiled=False``: there compiled steps are CUDA graphs, which run no Python.
        """
        return terms

    def on_iteration(self, metrics: dict[str, float]) -> bool | None:
        """Inspect an iteration's metrics, or add some, which are logged (TorchRL: ``post_steps_log``).

        Returns:
            True to end the run here; None or False to continue. The call's time is not part of the run's.
        """
        return None

    def on_checkpoint(self, state: dict[str, Any]) -> None:
        """Inspect a checkpoint before it is written; what is added (tensors, numbers, texts) is in it on resuming."""

    def on_resume(self, state: Mapping[str, Any]) -> None:
        """Inspect the checkpoint that the run continues from, after :meth:`load_state_dict`."""

    def on_train_end(self) -> None:
        """Clean up after the last checkpoint; also called if an error ended the run (TorchRL: ``shutdown``)."""

    def state_dict(self) -> dict[str, Any]:
        """Return what a resumed run needs of this callback: nested dicts of tensors, numbers and texts."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`."""


_HOOKS = tuple(name for name in vars(Callback) if name.startswith("on_"))


class Callbacks:
    """Callbacks of a run, in order; hooks that none overrides cost nothing.

    Raises:
        ConfigError: if one is not a :class:`Callback`, two have the same name, ``in_keys`` is not a list of keys, or a
            state is more than tensors, numbers and texts.
    """

    def __init__(self, callbacks: Sequence[Callback] = ()) -> None:
        if not isinstance(callbacks, Sequence):
            raise ConfigError(f"callbacks={callbacks!r}: give a list of Callback objects")
        self._all = tuple(callbacks)
        for callback in self._all:
            if not isinstance(callback, Callback):
                raise ConfigError(f"callbacks: {callback!r} is not a Callback object; subclass torchrl_atr's Callback")
            try:
                check_keys("in_keys", callback.in_keys)
            except InputError as error:
                raise ConfigError(f"{error} (of the callback {callback.name!r})") from None
        names = [callback.name for callback in self._all]
        if doubled := [name for name in names if names.count(name) > 1]:
            raise ConfigError(f"two callbacks are called {doubled[0]!r}; give one another `name`")
        self._by_hook = {hook: [each for each in self._all if _overrides(each, hook)] for hook in _HOOKS}
        self.state_dict()

    def calling(self, hook: str) -> list[Callback]:
        """Return the callbacks that override a hook."""
        return self._by_hook[hook]

    @property
    def in_keys(self) -> list[NestedKey]:
        """Batch entries that minibatches hold for the callbacks."""
        return list(chain.from_iterable(each.in_keys for each in self._all))

    def call(self, hook: str, *arguments: Any) -> list[Any]:
        """Return the results of a hook of the callbacks that override it."""
        return [getattr(callback, hook)(*arguments) for callback in self._by_hook[hook]]

    def through(self, hook: str, data: TensorDictBase, *arguments: Any) -> TensorDictBase:
        """Return ``data`` after a hook of each callback, a TensorDict too; the one that is given keeps its entries."""
        for callback in self._by_hook[hook]:
            data = getattr(callback, hook)(data.copy(), *arguments)
            if not isinstance(data, TensorDictBase):
                raise ConfigError(f"{hook} of the callback {callback.name!r} returned {data!r}; return the TensorDict")
        return data

    def checkpoint(self, state: dict[str, Any]) -> None:
        """Call :meth:`Callback.on_checkpoint` of each."""
        for callback in self.calling("on_checkpoint"):
            before = set(state)
            callback.on_checkpoint(state)
            _check_plain({name: state[name] for name in state.keys() - before}, callback, "on_checkpoint added")

    def state_dict(self) -> dict[str, Any]:
        """Return the states by name, without empty ones; ConfigError if one is more than tensors, numbers and texts."""
        states = {}
        for callback in self._all:
            if state := callback.state_dict():
                _check_plain(state, callback, "state_dict returned")
                states[callback.name] = state
        return states

    def load_state_dict(self, states: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`; the state of a callback that the run does not have is skipped, with a warning.

        Raises:
            CheckpointError: if a callback cannot take its state.
        """
        for name in states.keys() - {callback.name for callback in self._all}:
            _LOG.warning("the checkpoint has a state of the callback %r, which is not among the run's callbacks", name)
        for callback in self._all:
            if callback.name not in states:
                continue
            try:
                callback.load_state_dict(states[callback.name])
            except Exception as error:
                raise CheckpointError(
                    f"the callback {callback.name!r} cannot take its state from the checkpoint "
                    f"({type(error).__name__}: {first_line(error)}); give the one that the run was trained with"
                ) from error


def _overrides(callback: Callback, hook: str) -> bool:
    method: Any = getattr(callback, hook)
    return getattr(method, "__func__", method) is not getattr(Callback, hook)


def _check_plain(state: Any, callback: Callback, what: str) -> None:
    try:
        torch.save(state, buffer := io.BytesIO())
        buffer.seek(0)
        torch.load(buffer, weights_only=True)
    except Exception as error:
        raise ConfigError(
            f"what {what} of the callback {callback.name!r} cannot be kept in a checkpoint; give nested dicts of "
            "tensors, numbers and texts"
        ) from error

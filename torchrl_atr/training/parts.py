"""Parts of a run that a user can replace: env, networks, loss, callbacks; by default they are the recipe's."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import nn
from torchrl.envs import EnvBase

from torchrl_atr._errors import UserError, first_line
from torchrl_atr.config import ConfigError, TrainConfig
from torchrl_atr.modules import get_estimator
from torchrl_atr.runs.checkpoint import CheckpointError
from torchrl_atr.runs.files import DUMPS
from torchrl_atr.training.assembly import check_run_estimator, make_env, make_run_networks
from torchrl_atr.training.callbacks import Callbacks

FACTORIES = ("make_env", "make_networks", "make_loss")
"""Arguments of a run that are factories of its parts."""
NETWORKS_INTERFACE = (
    "rollout_policy",
    "training_actor",
    "deployed_policy",
    "encoder_module",
    "intrinsic_estimator_module",
    "extrinsic_estimator_module",
    "critic_module",
    "encoder",
    "backbone",
    "exploration",
    "critic",
    "estimator_parameters",
    "update_normalizers",
)
"""Attributes of a run's networks, as of :class:`~torchrl_atr.modules.ROANetworks`; see docs/own_parts.md."""
LOSS_INTERFACE = ("policy_loss", "adaptation_loss", "policy_in_keys", "adaptation_in_keys")
"""Attributes of a run's loss, as of :class:`~torchrl_atr.objectives.ROAClipPPOLoss`; see docs/own_parts.md."""


class EnvFactory(Protocol):
    """Factory of envs on the CPU, of batch size (num_envs,), in this process or in a worker's.

    All that an env draws follows from the seed; ``num_threads=None`` means the CPUs that the process may use.
    """

    def __call__(self, *, num_envs: int, seed: int, num_threads: int | None) -> EnvBase:
        """Make an env."""
        ...


NetworksFactory = Callable[[Any], Any]
"""``make_networks(env)`` returns a module with :data:`NETWORKS_INTERFACE`, on the CPU."""
LossFactory = Callable[[Any], Any]
"""``make_loss(networks)`` returns a module with :data:`LOSS_INTERFACE`, whose parameters are the networks'."""


@dataclass(frozen=True)
class Parts:
    """Parts of a run besides its configuration; None stands for the recipe's, made from the configuration.

    It replaces the Hydra configurations of ``torchrl.trainers.algorithms.configs``, which make parts by name, but do
    not check that the result can be trained.

    Attributes:
        make_env, make_networks, make_loss, callbacks: see :class:`~torchrl_atr.training.Trainer`.
    """

    make_env: EnvFactory | None = None
    make_networks: NetworksFactory | None = None
    make_loss: LossFactory | None = None
    callbacks: Callbacks = field(default_factory=Callbacks)

    @property
    def names(self) -> dict[str, str]:
        """Full name of each custom factory by its argument, as checkpoints store it."""
        return {name: _full_name(factory) for name, factory in self._factories.items()}

    @property
    def _factories(self) -> dict[str, Any]:
        factories = {name: getattr(self, name) for name in FACTORIES}
        return {name: factory for name, factory in factories.items() if factory is not None}

    def check(self, config: TrainConfig) -> None:
        """Check that factories are callable, and that what other processes need can be sent to them.

        Raises:
            ConfigError: if not, or if a callback cannot work with the configuration; names it and the remedy.
            UnknownNameError: for an unregistered estimator of the recipe's own networks.
        """
        for name, factory in self._factories.items():
            if not callable(factory):
                raise ConfigError(f"{name}={factory!r} cannot be called; give a function, or a class")
            if isinstance(factory, nn.Module):  # modules can be called, and envs are modules
                raise ConfigError(f"{name}={type(factory).__name__}(...) is what is to be made; give what makes it")
        if self.make_networks is None:
            get_estimator(config.estimator.name)
        if config.compute.collector != "direct" and self.make_env is not None:
            _check_picklable("make_env", self.make_env, config)
        if config.captures_graphs and (culprits := self.callbacks.calling("on_loss")):
            raise ConfigError(
                f"on_loss of the callback {culprits[0].name!r}: with compute.compiled=true optimiser steps on a GPU "
                "are CUDA graphs, which run no Python; set compute.compiled=false, or use on_minibatch"
            )

    def check_complete(self, state: Mapping[str, Any], run: Path, needed: Collection[str]) -> None:
        """Check that those of the ``needed`` custom factories that a run was trained with have been given again.

        Raises:
            CheckpointError: if one is missing; says which, and how to give it.
        """
        trained = state.get("parts", {})
        missing = [name for name in needed if name in trained and getattr(self, name) is None]
        if missing:
            theirs = " and ".join(f"{name}={trained[name]}" for name in missing)
            given = ", ".join(f"{name}=..." for name in missing)
            raise CheckpointError(
                f"{run} was trained with {theirs}, custom code that the command line cannot give; in Python, pass "
                f"{given} to Trainer to continue it, or to load_run to use it (docs/own_parts.md)"
            )

    def env_maker(self, config: TrainConfig, run: Path) -> Callable[..., EnvBase]:
        """Return the factory of a run's envs for any process; it takes no arguments, or some to replace the run's."""
        if self.make_env is None:
            return partial(make_env, config, dump_dir=run.resolve() / DUMPS)
        envs, threads = config.env.num_envs, config.compute.num_threads or None
        return partial(_own_env, self.make_env, num_envs=envs, seed=config.seed, num_threads=threads)

    def networks(self, config: TrainConfig, env: EnvBase) -> Any:
        """Return the networks of a run, on the CPU.

        Raises:
            ConfigError: if the recipe's networks do not fit a custom env or task, or custom ones lack an attribute.
            EstimatorError: if the estimator of the recipe's networks cannot be trained.
        """
        if self.make_networks is not None:
            networks = self.make_networks(env)
            _check_interface("make_networks", networks, NETWORKS_INTERFACE, "ROANetworks of make_networks")
            return networks
        recipes_env: Any = env
        own = self.make_env is not None
        try:
            check_run_estimator(config, recipes_env)
            return make_run_networks(config, recipes_env)
        except (AttributeError, KeyError, RuntimeError, ValueError) as error:
            if not own and (isinstance(error, UserError) or not isinstance(error, KeyError)):
                raise
            env_of = f"the env of {_full_name(self.make_env)}" if own else f"the task {config.task.name!r}"
            raise ConfigError(
                f"the recipe's networks do not fit {env_of} ({type(error).__name__}: {first_line(error)}); give "
                "make_networks= too"
            ) from error

    def loss(self, config: TrainConfig, networks: Any) -> Any:
        """Return the custom loss; None for the recipe's, which the learner makes.

        Raises:
            ConfigError: if it lacks an attribute, or has parameters that no optimiser would train.
        """
        if self.make_loss is None:
            return None
        loss = self.make_loss(networks)
        _check_interface("make_loss", loss, LOSS_INTERFACE, "ROAClipPPOLoss")
        if config.roa.ramp and not hasattr(loss, "roa_coeff"):
            raise ConfigError(
                "roa.ramp=true needs a loss with roa_coeff, which that of make_loss lacks; set it to false"
            )
        known = {id(parameter) for parameter in networks.parameters()}
        strangers = [name for name, value in loss.named_parameters() if value.requires_grad and id(value) not in known]
        if strangers:
            raise ConfigError(
                f"make_loss={_full_name(self.make_loss)}: no optimiser trains the loss's parameter {strangers[0]!r} "
                f"({len(strangers)} such); make it part of the networks that make_networks returns"
            )
        return loss


def _own_env(factory: EnvFactory, *, num_envs: int, **arguments: Any) -> EnvBase:
    """Make a custom env and check its type, batch size and device."""
    env = factory(num_envs=num_envs, **arguments)
    name = f"make_env={_full_name(factory)}"
    if not isinstance(env, EnvBase):
        raise ConfigError(f"{name} returned {type(env).__name__}; return a torchrl.envs.EnvBase")
    if env.batch_size != torch.Size([num_envs]):
        raise ConfigError(
            f"{name} made an env of batch size {tuple(env.batch_size)}; it must be (num_envs,) = ({num_envs},)"
        )
    if env.device is not None and env.device.type != "cpu":
        raise ConfigError(f"{name} made an env on {env.device}; envs are on the CPU, device= is the learner's")
    return env


def _check_interface(argument: str, module: Any, interface: Collection[str], model: str) -> None:
    if not isinstance(module, nn.Module):
        raise ConfigError(f"{argument} returned {type(module).__name__}; return a torch.nn.Module such as {model}")
    missing = [name for name in interface if not hasattr(module, name)]
    if missing:
        raise ConfigError(
            f"{argument} returned {type(module).__name__}, which lacks {', '.join(missing)}; see docs/own_parts.md, or "
            f"subclass {model}"
        )


def _check_picklable(name: str, value: Any, config: TrainConfig) -> None:
    try:
        pickle.dumps(value)
    except Exception as error:
        raise ConfigError(
            f"{name}={value!r} cannot be pickled ({first_line(error)}), and collector={config.compute.collector!r} "
            "sends it to other processes; give a function or class that a module defines at its top level, or "
            "functools.partial of one"
        ) from error


def _full_name(factory: Any) -> str:
    while isinstance(factory, partial):
        factory = factory.func
    kind = factory if hasattr(factory, "__qualname__") else type(factory)
    return f"{kind.__module__}.{kind.__qualname__}"

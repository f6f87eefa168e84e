"""Factory of all networks of RL-ATR for an env, sized by its specs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Composite, TensorSpec

from torchrl_atr._checks import check_choice, check_flag, check_kind, check_whole
from torchrl_atr._errors import InputError
from torchrl_atr.modules.act_source import ACTOR_INPUTS, ActorInput
from torchrl_atr.modules.actor import ActorBackbone
from torchrl_atr.modules.critic import AsymmetricCritic
from torchrl_atr.modules.dtype import default_dtype
from torchrl_atr.modules.encoder import IntrinsicEncoder
from torchrl_atr.modules.estimators import (
    EstimatorError,
    EstimatorModule,
    EstimatorSpec,
    NormalizedEstimator,
    WindowModule,
    build_estimator,
    get_estimator,
)
from torchrl_atr.modules.exploration import Exploration
from torchrl_atr.modules.keys import NetworkKeys
from torchrl_atr.modules.networks import ROANetworks
from torchrl_atr.modules.normalization import RunningNormalizer
from torchrl_atr.modules.sizes import check_widths, entry, entry_shape, estimator_specs, input_sizes


def make_networks(
    observation_spec: Composite,
    action_spec: TensorSpec,
    *,
    estimator: str = "cnn_gru",
    estimator_kwargs: Mapping[str, Any] | None = None,
    estimator_inputs: Sequence[NestedKey] = (),
    shared_estimator: bool = False,
    actor_reads: Sequence[ActorInput] = ("latent", "extrinsic"),
    actor_reads_scale: bool = False,
    latent_features: int = 16,
    encoder_cells: Sequence[int] = (128, 64),
    actor_cells: Sequence[int] = (512, 256, 128),
    input_products: Sequence[tuple[int, int]] = (),
    input_errors: Sequence[tuple[int, int]] = (),
    output_map: Tensor | None = None,
    exploration: Exploration | None = None,
    critic_cells: Sequence[int] = (512, 256, 128),
    privileged_critic: bool = True,
    critic_inputs: Sequence[NestedKey] = (),
    reflections: Mapping[NestedKey, Tensor] | None = None,
    keys: NetworkKeys | None = None,
) -> ROANetworks:
    """Build the networks of Table I for an env; sizes and the dtype, the observation's, are read from its specs.

    Args:
        observation_spec (Composite): must hold the observation (*B, O), the history (*B, H, O), both privileged
            entries, and those of ``estimator_inputs`` and ``critic_inputs``, (*B, D) each; leading batch dimensions
            are ignored. An entry that no argument names is not read.
        action_spec (TensorSpec): a leaf of shape (*B, A), or a Composite with the action key.
        estimator (str): a registered name (:func:`torchrl_atr.modules.available_estimators`).
        estimator_kwargs (mapping, optional): passed to the estimator's factory.
        estimator_inputs (sequence of NestedKey): entries that the extrinsic estimator reads beside the history, such as
            ``["dead_reckoned_velocity"]``. The deployed policy reads them too. Defaults to none.
        shared_estimator (bool): whether one estimator has both roles. Defaults to False: one for each.
        actor_reads (sequence of str): what the actor reads beside the observation: ``history``, ``latent``,
            ``extrinsic``, or some of these, in any order. There is an encoder, and an estimator, of what it reads
            alone. Defaults to latent and extrinsic state.
        actor_reads_scale (bool): whether the actor also reads the estimates' standard deviations, which the estimator
            must then write, and zeros for what is privileged. Defaults to False.
        latent_features (int): size of z. Defaults to 16.
        encoder_cells (sequence of int): hidden widths of the encoder.
        actor_cells (sequence of int): hidden widths of the actor.
        input_products (sequence of pairs of int): see :class:`~torchrl_atr.modules.ActorBackbone`.
        input_errors (sequence of pairs of int): the same.
        output_map (Tensor, optional): see :class:`~torchrl_atr.modules.ActorBackbone`.
        exploration (Exploration, optional): of as many actions; it becomes part of the networks, in their dtype.
            None, the default, is ``Exploration(A)``.
        critic_cells (sequence of int): hidden widths of the critic.
        privileged_critic (bool): whether the critic reads both privileged entries, too (question A20).
        critic_inputs (sequence of NestedKey): entries that the critic reads in addition, such as
            ``[("privileged", "tracking_forecast")]``. Defaults to none.
        reflections (mapping of NestedKey to Tensor, optional): reflection matrix by entry, (D, D) for the
            observation, the privileged entries, the further inputs and the action, such as
            :attr:`~torchrl_atr.envs.RidingEnv.reflections`. Encoder, actor and critic are then symmetric by
            construction: the mirrored robot acts mirrored. The estimators are not, so that any can be registered.
        keys (NetworkKeys, optional): names of the entries, if the env has its own.

    Returns:
        ROANetworks

    Raises:
        KeyError: if a spec or the reflections lack an entry. ValueError: if the history does not match the
            observation, the estimator is unknown, the exploration is of another number of actions, or a reflection is
            invalid. EstimatorError: if the estimator's factory fails, or it lacks the scales that the actor is to read.

    Example:
        >>> from torchrl.data import Composite, Unbounded
        >>> spec = Composite(
        ...     observation=Unbounded((5,)),
        ...     history=Unbounded((4, 5)),
        ...     wind=Unbounded((2,)),
        ...     privileged=Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,))),
        ... )
        >>> networks = make_networks(spec, Unbounded((2,)), estimator="mlp", estimator_inputs=["wind"])
        >>> sorted(networks.deployed_policy().in_keys)
        ['history', 'observation', 'wind']
    """
    check_whole("latent_features", latent_features, low=1)
    check_widths(actor_cells=actor_cells, critic_cells=critic_cells, encoder_cells=encoder_cells)
    check_flag("privileged_critic", privileged_critic)
    check_flag("shared_estimator", shared_estimator)
    check_kind("actor_reads", actor_reads, (list, tuple), f"a list of some of {', '.join(ACTOR_INPUTS)}")
    for name in actor_reads:
        check_choice("actor_reads", name, ACTOR_INPUTS)
    check_flag("actor_reads_scale", actor_reads_scale)
    check_kind("estimator_kwargs", estimator_kwargs, Mapping, "a mapping of arguments", optional=True)
    check_kind("exploration", exploration, Exploration, "Exploration(actions, ...)", optional=True)
    check_kind("output_map", output_map, Tensor, "a matrix", optional=True)
    check_kind("reflections", reflections, Mapping, "a matrix by key", optional=True)
    check_kind("keys", keys, NetworkKeys, "NetworkKeys(...)", optional=True)
    keys = keys or NetworkKeys()
    obs, intrinsic, extrinsic = _observation_sizes(observation_spec, keys)
    (actions,) = entry_shape(action_spec, keys.action, 1)
    factory, options = get_estimator(estimator), dict(estimator_kwargs or {})
    specs = estimator_specs(observation_spec, latent_features, keys, estimator_inputs, shared_estimator, actor_reads)
    reads_latent, reads_extrinsic = (name in actor_reads for name in ("latent", "extrinsic"))
    mirror = partial(_reflection, reflections)
    with default_dtype(entry(observation_spec, keys.observation).dtype):
        side_norms = _norms(observation_spec, "estimator_inputs", estimator_inputs, mirror)
        input_norms = _norms(observation_spec, "critic_inputs", critic_inputs, mirror)
        obs_norm = RunningNormalizer(obs, reflection=mirror(keys.observation))
        ext_norm = RunningNormalizer(extrinsic, reflection=mirror(keys.extrinsic))
        encoder = None
        if reads_latent:
            encoder = IntrinsicEncoder(intrinsic, latent_features, encoder_cells, mirror(keys.intrinsic))
        norms = obs_norm, ext_norm, dict(zip(estimator_inputs, side_norms))
        nets = {role: build_estimator(factory, each, **options) for role, each in specs.items()}
        estimators = {role: _normalized(nets[role], each, *norms) for role, each in specs.items()}
        if actor_reads_scale:
            _check_scales(estimator, estimators.values())
        backbone = ActorBackbone(
            obs_norm,
            ext_norm if reads_extrinsic else None,
            latent_features if reads_latent else 0,
            actions,
            cells=actor_cells,
            input_products=input_products,
            input_errors=input_errors,
            reflection=mirror(keys.action),
            output_map=output_map,
            reads_scale=actor_reads_scale,
            history_length=entry_shape(observation_spec, keys.history, 2)[0] if "history" in actor_reads else 0,
        )
        critic = AsymmetricCritic(
            obs_norm,
            ext_norm if privileged_critic else None,
            intrinsic if privileged_critic else 0,
            critic_cells,
            input_norms,
            intrinsic_reflection=mirror(keys.intrinsic),
        )
        return ROANetworks(
            obs_norm=obs_norm,
            ext_norm=ext_norm,
            encoder=encoder,
            intrinsic_estimator=estimators.get("both" if shared_estimator else "intrinsic"),
            extrinsic_estimator=estimators.get("both" if shared_estimator else "extrinsic"),
            backbone=backbone,
            exploration=_exploration_of(actions, exploration),
            critic=critic,
            estimator_inputs=estimator_inputs,
            critic_inputs=critic_inputs,
            keys=keys,
        )


def _observation_sizes(spec: Composite, keys: NetworkKeys) -> tuple[int, int, int]:
    """Return the sizes of the observation, the intrinsic parameters and the extrinsic state, if the history fits."""
    (obs,) = entry_shape(spec, keys.observation, 1)
    history_shape = entry_shape(spec, keys.history, 2)
    (intrinsic,) = entry_shape(spec, keys.intrinsic, 1)
    (extrinsic,) = entry_shape(spec, keys.extrinsic, 1)
    dtype = entry(spec, keys.observation).dtype
    for key in (keys.history, keys.intrinsic, keys.extrinsic):
        if (other := entry(spec, key).dtype) != dtype:
            raise InputError(
                f"{key!r} is {other}, {keys.observation!r} {dtype}; give all of one dtype, such as by torchrl's "
                "DoubleToFloat"
            )
    if history_shape[1] != obs:
        raise ValueError(
            f"{keys.history!r} must end with (H, {obs}), as {keys.observation!r} has {obs} components; got "
            f"{history_shape}. The history stacks past observations, oldest first."
        )
    return obs, intrinsic, extrinsic


def _norms(
    spec: Composite, argument: str, inputs: Sequence[NestedKey], mirror: Callable[[NestedKey], Tensor | None]
) -> list[RunningNormalizer]:
    """Return a normaliser for each entry that an argument names."""
    sizes = input_sizes(spec, argument, inputs)
    return [RunningNormalizer(size, reflection=mirror(key)) for key, size in zip(inputs, sizes)]


def _normalized(
    net: nn.Module,
    spec: EstimatorSpec,
    obs_norm: RunningNormalizer,
    ext_norm: RunningNormalizer,
    side_norms: Mapping[NestedKey, RunningNormalizer],
) -> NormalizedEstimator | EstimatorModule:
    """Return an estimator between the normalisers of what it reads and estimates."""
    side = {key: side_norms[key] for key in spec.inputs}
    if isinstance(net, TensorDictModuleBase):
        return EstimatorModule(net, spec, obs_norm, ext_norm, side)
    if spec.role == "both":
        return EstimatorModule(WindowModule(net, spec), spec, obs_norm, ext_norm, side)
    return NormalizedEstimator(net, obs_norm, ext_norm if spec.role == "extrinsic" else None, list(side.values()))


def _check_scales(name: str, estimators: Iterable[nn.Module]) -> None:
    if not all(isinstance(each, EstimatorModule) and each.writes_scale for each in estimators):
        raise EstimatorError(
            f"actor_reads_scale=True, and the estimator {name!r} estimates no standard deviations; take one that does, "
            "such as 'gaussian', or leave it False"
        )


def _exploration_of(actions: int, given: Exploration | None) -> Exploration:
    """Return the exploration that was given, in the default dtype, or the default one."""
    if given is None:
        return Exploration(actions)
    if len(given.raw) != actions:
        raise ValueError(
            f"exploration is of {len(given.raw)} actions and the action spec has {actions}; give "
            f"Exploration({actions}, ...)."
        )
    return given.to(torch.get_default_dtype())


def _reflection(reflections: Mapping[NestedKey, Tensor] | None, key: NestedKey) -> Tensor | None:
    """Return the reflection of an entry; None without reflections."""
    if reflections is None:
        return None
    if key not in reflections:
        raise KeyError(f"reflections lack {key!r}; they have {list(reflections)}, and symmetric networks need it too")
    return reflections[key]

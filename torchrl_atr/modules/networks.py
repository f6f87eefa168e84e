"""All networks of RL-ATR around one set of parameters, and the policies that are views of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import Composite, TensorSpec
from torchrl.modules import ProbabilisticActor, ValueOperator

from torchrl_atr._checks import check_flag, check_kind, check_whole
from torchrl_atr.modules.act_source import ActSource, AssignActSource, Source, check_source
from torchrl_atr.modules.actor import ActorBackbone, make_actor
from torchrl_atr.modules.critic import AsymmetricCritic
from torchrl_atr.modules.dtype import default_dtype
from torchrl_atr.modules.encoder import IntrinsicEncoder
from torchrl_atr.modules.estimators import NormalizedEstimator, build_estimator, get_estimator
from torchrl_atr.modules.keys import NetworkKeys
from torchrl_atr.modules.normalization import RunningNormalizer
from torchrl_atr.modules.sizes import check_widths, entry, entry_shape, estimator_sizes


class RidingNetworks(nn.Module):
    """The five networks of Table I and the critic; every policy made here shares their parameters.

    Build it with :func:`make_networks`. The TensorDictModules it returns are views: making one costs
    nothing and training one trains the networks.

    Args:
        obs_norm, ext_norm (RunningNormalizer): of the observation and of the extrinsic state (SI units).
        encoder (nn.Module): intrinsic parameters to latent.
        intrinsic_estimator, extrinsic_estimator (NormalizedEstimator): history to latent, to extrinsic state.
        backbone (ActorBackbone): the actor.
        critic (AsymmetricCritic): the value.
        keys (NetworkKeys): names of the entries.
    """

    def __init__(
        self,
        *,
        obs_norm: RunningNormalizer,
        ext_norm: RunningNormalizer,
        encoder: nn.Module,
        intrinsic_estimator: NormalizedEstimator,
        extrinsic_estimator: NormalizedEstimator,
        backbone: ActorBackbone,
        critic: AsymmetricCritic,
        keys: NetworkKeys | None = None,
    ) -> None:
        super().__init__()
        self.obs_norm, self.ext_norm = obs_norm, ext_norm
        self.encoder = encoder
        self.intrinsic_estimator, self.extrinsic_estimator = intrinsic_estimator, extrinsic_estimator
        self.backbone = backbone
        self.critic = critic
        self.keys = keys or NetworkKeys()

    @property
    def encoder_module(self) -> TensorDictModule:
        """Encoder: intrinsic parameters (*B, I) to the latent z (*B, L)."""
        return TensorDictModule(self.encoder, in_keys=[self.keys.intrinsic], out_keys=[self.keys.latent])

    @property
    def intrinsic_estimator_module(self) -> TensorDictModule:
        """Intrinsic estimator: history (*B, H, D) to the estimated latent (*B, L)."""
        keys = self.keys
        return TensorDictModule(self.intrinsic_estimator, in_keys=[keys.history], out_keys=[keys.intrinsic_estimate])

    @property
    def extrinsic_estimator_module(self) -> TensorDictModule:
        """Extrinsic estimator: history (*B, H, D) and odometry, if used, to the extrinsic state (*B, E), SI units."""
        keys, estimator = self.keys, self.extrinsic_estimator
        in_keys = [keys.history] if estimator.side_norm is None else [keys.history, keys.odometry]
        return TensorDictModule(estimator, in_keys=in_keys, out_keys=[keys.extrinsic_estimate])

    @property
    def critic_module(self) -> ValueOperator:
        """Critic: observation, both privileged entries and the outlook, if used, to the state value (*B, 1)."""
        keys = self.keys
        in_keys = [keys.observation]
        if self.critic.extrinsic_norm is not None:
            in_keys += [keys.intrinsic, keys.extrinsic]
        if self.critic.outlook_norm is not None:
            in_keys.append(keys.outlook)
        return ValueOperator(self.critic, in_keys=in_keys, out_keys=[keys.state_value])

    def training_actor(self, source: Source = "privileged") -> ProbabilisticActor:
        """Return the actor that the loss differentiates.

        With ``estimated`` and ``mixed`` it reads the estimates (and the mask) that the rollout recorded
        instead of computing them again: the importance ratio of the first minibatch is one even after the
        estimators moved.
        """
        check_source(source)
        front = [] if source == "estimated" else [self.encoder_module]
        return self._actor(source, *front)

    def rollout_policy(self, source: Source = "privileged", student_fraction: float = 0.5) -> ProbabilisticActor:
        """Return the actor that collects; it computes and records what :meth:`training_actor` reads.

        Args:
            source (str): ``privileged``, ``estimated`` or ``mixed``.
            student_fraction (float): with ``mixed``, the share of robots that act on the estimates.
        """
        check_source(source)
        estimators = [self.intrinsic_estimator_module, self.extrinsic_estimator_module]
        if source == "privileged":
            return self._actor(source, self.encoder_module)
        if source == "estimated":
            return self._actor(source, *estimators)
        assign = AssignActSource(student_fraction, reference=self.keys.observation, student=self.keys.student)
        return self._actor(source, self.encoder_module, *estimators, assign)

    def deployed_policy(self) -> ProbabilisticActor:
        """Return the policy of the real robot: it reads history, observation and odometry, nothing privileged.

        It shares the networks and their mode: call ``eval()`` on networks that were trained with dropout or batch
        statistics before they are deployed. Those of :func:`torchrl_atr.training.load_run` and
        ``Learner.deployed`` are in eval mode.
        """
        return self.rollout_policy("estimated")

    def update_normalizers(self, tensordict: TensorDictBase) -> None:
        """Merge a batch's observations, extrinsic states and side inputs into the running statistics.

        Call it between iterations: after the epochs on a batch, before the next rollout.
        """
        keys = self.keys
        for norm, key in (
            (self.obs_norm, keys.observation),
            (self.ext_norm, keys.extrinsic),
            (self.extrinsic_estimator.side_norm, keys.odometry),
            (self.critic.outlook_norm, keys.outlook),
        ):
            if norm is None:
                continue
            value = tensordict.get(key, None)
            if value is None:
                raise KeyError(f"the batch lacks {key!r}, which is normalised; keep it, or rename it in NetworkKeys")
            norm.update(value)

    def policy_parameters(self) -> Iterator[nn.Parameter]:
        """Iterate over what PPO and the ROA term train: encoder, actor and critic."""
        return chain(self.encoder.parameters(), self.backbone.parameters(), self.critic.parameters())

    def estimator_parameters(self) -> Iterator[nn.Parameter]:
        """Iterate over what the estimator losses train: both estimators."""
        return chain(self.intrinsic_estimator.parameters(), self.extrinsic_estimator.parameters())

    def _actor(self, source: Source, *front: Any) -> ProbabilisticActor:
        keys = self.keys
        act_source = ActSource(
            source,
            latent=keys.latent,
            extrinsic=keys.extrinsic,
            intrinsic_estimate=keys.intrinsic_estimate,
            extrinsic_estimate=keys.extrinsic_estimate,
            student=keys.student,
            act_intrinsic=keys.act_intrinsic,
            act_extrinsic=keys.act_extrinsic,
        )
        actor = make_actor(
            self.backbone,
            *front,
            act_source,
            observation=keys.observation,
            act_intrinsic=keys.act_intrinsic,
            act_extrinsic=keys.act_extrinsic,
            action=keys.action,
        )
        return actor if self.training else actor.eval()


def make_networks(
    observation_spec: Composite,
    action_spec: TensorSpec,
    *,
    estimator: str = "cnn_gru",
    estimator_kwargs: Mapping[str, Any] | None = None,
    latent_features: int = 16,
    actor_cells: Sequence[int] = (512, 256, 128),
    critic_cells: Sequence[int] = (512, 256, 128),
    privileged_critic: bool = True,
    init_std: float | Sequence[float] = 0.3,
    min_std: float = 0.05,
    noise_basis: Tensor | None = None,
    products: Sequence[tuple[int, int]] = (),
    reflections: Mapping[NestedKey, Tensor] | None = None,
    keys: NetworkKeys | None = None,
) -> RidingNetworks:
    """Build the networks of Table I for an env; sizes and the dtype, the observation's, are read from its specs.

    Args:
        observation_spec (Composite): must hold the observation (*B, O), the history (*B, H, O) and both
            privileged entries; leading batch dimensions are ignored.
        action_spec (TensorSpec): a leaf of shape (*B, A), or a Composite with the action key.
        estimator (str): a registered name (:func:`torchrl_atr.modules.available_estimators`).
        estimator_kwargs (mapping, optional): passed to the estimator's factory.
        latent_features (int): size of z. Defaults to 16.
        actor_cells (sequence of int): hidden widths of the actor.
        critic_cells (sequence of int): hidden widths of the critic.
        privileged_critic (bool): whether the critic reads more than the observation (reading A20).
        init_std (float or sequence of float): initial exploration, in units of the action; one per column of the
            noise basis if it is a sequence.
        min_std (float): its floor.
        noise_basis (Tensor, optional): see :class:`~torchrl_atr.modules.ActorBackbone`.
        products (sequence of pairs of int): see :class:`~torchrl_atr.modules.ActorBackbone`.
        reflections (mapping of NestedKey to Tensor, optional): how each entry's mirror image is made, (D, D) for the
            observation, the privileged entries, the odometry and the action, such as
            :attr:`~torchrl_atr.envs.RidingEnv.reflections`. Encoder, actor and critic are then symmetric by
            construction: the mirrored robot acts mirrored. The estimators are not, so that any can be registered.
        keys (NetworkKeys, optional): names of the entries, if the env has its own.

    Returns:
        RidingNetworks

    Raises:
        KeyError: if a spec or the reflections lack an entry. ValueError: if the history does not match the
            observation, the estimator is unknown, or a reflection is none. EstimatorError: if the estimator's
            factory fails.

    Examples:
        >>> from torchrl.data import Composite, Unbounded
        >>> spec = Composite(
        ...     observation=Unbounded((5,)),
        ...     history=Unbounded((4, 5)),
        ...     privileged=Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,))),
        ... )
        >>> networks = make_networks(spec, Unbounded((2,)), estimator="mlp")
        >>> sorted(networks.deployed_policy().in_keys)
        ['history', 'observation']
    """
    check_whole("latent_features", latent_features, low=1)
    check_widths(actor_cells=actor_cells, critic_cells=critic_cells)
    check_flag("privileged_critic", privileged_critic)
    check_kind("estimator_kwargs", estimator_kwargs, Mapping, "a mapping of arguments", optional=True)
    check_kind("reflections", reflections, Mapping, "a matrix by key", optional=True)
    check_kind("keys", keys, NetworkKeys, "NetworkKeys(...)", optional=True)
    keys = keys or NetworkKeys()
    (obs,) = entry_shape(observation_spec, keys.observation, 1)
    history_shape = entry_shape(observation_spec, keys.history, 2)
    (intrinsic,) = entry_shape(observation_spec, keys.intrinsic, 1)
    (extrinsic,) = entry_shape(observation_spec, keys.extrinsic, 1)
    (actions,) = entry_shape(action_spec, keys.action, 1)
    if history_shape[1] != obs:
        raise ValueError(
            f"{keys.history!r} must end with (H, {obs}), as {keys.observation!r} has {obs} components; got "
            f"{history_shape}. The history stacks past observations, oldest first."
        )
    make_estimator = partial(build_estimator, get_estimator(estimator), **dict(estimator_kwargs or {}))
    sizes = estimator_sizes(observation_spec, latent_features, keys)
    mirror = partial(_reflection, reflections)
    with default_dtype(entry(observation_spec, keys.observation).dtype):
        obs_norm = RunningNormalizer(obs, reflection=mirror(keys.observation))
        ext_norm = RunningNormalizer(extrinsic, reflection=mirror(keys.extrinsic))
        odometry_norm, outlook_norm = (
            RunningNormalizer(entry_shape(observation_spec, key, 1), reflection=mirror(key))
            if key is not None and key in observation_spec.keys(True, True)
            else None
            for key in (keys.odometry, keys.outlook)
        )
        return RidingNetworks(
            obs_norm=obs_norm,
            ext_norm=ext_norm,
            encoder=IntrinsicEncoder(intrinsic, latent_features, reflection=mirror(keys.intrinsic)),
            intrinsic_estimator=NormalizedEstimator(
                make_estimator(history_shape=sizes["intrinsic"][0], out_features=sizes["intrinsic"][1]), obs_norm
            ),
            extrinsic_estimator=NormalizedEstimator(
                make_estimator(history_shape=sizes["extrinsic"][0], out_features=sizes["extrinsic"][1]),
                obs_norm,
                ext_norm,
                odometry_norm,
            ),
            backbone=ActorBackbone(
                obs_norm,
                ext_norm,
                latent_features,
                actions,
                actor_cells,
                init_std,
                min_std,
                noise_basis,
                products,
                mirror(keys.action),
            ),
            critic=AsymmetricCritic(
                obs_norm, ext_norm, intrinsic, critic_cells, outlook_norm, intrinsic_reflection=mirror(keys.intrinsic)
            )
            if privileged_critic
            else AsymmetricCritic(obs_norm, cells=critic_cells),
            keys=keys,
        )


def _reflection(reflections: Mapping[NestedKey, Tensor] | None, key: NestedKey) -> Tensor | None:
    """The reflection of an entry, if there are any."""
    if reflections is None:
        return None
    if key not in reflections:
        raise KeyError(f"reflections lack {key!r}; they have {list(reflections)}, and symmetric networks need it too")
    return reflections[key]

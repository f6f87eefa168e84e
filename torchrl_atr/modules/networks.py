"""All networks of RL-ATR with one set of parameters, and the policies that are views of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn
from torchrl.modules import ProbabilisticActor, ValueOperator

from torchrl_atr._errors import InputError
from torchrl_atr.modules.act_scale import ActScale
from torchrl_atr.modules.act_source import ActSource, ActSourceName, AssignActSource, check_source
from torchrl_atr.modules.actor import ActorBackbone, make_actor
from torchrl_atr.modules.command_range import CommandClippedPolicy, CommandRange
from torchrl_atr.modules.critic import AsymmetricCritic
from torchrl_atr.modules.estimators import EstimatorModule, NormalizedEstimator, state_keys
from torchrl_atr.modules.exploration import Exploration
from torchrl_atr.modules.keys import NetworkKeys
from torchrl_atr.modules.normalization import RunningNormalizer


class ROANetworks(nn.Module):
    """Container of the five networks of Table I and the critic; all its policies share their parameters.

    Build it with :func:`~torchrl_atr.modules.make_networks`. The TensorDictModules it returns are views: making one
    costs nothing and training one trains the networks.

    Args:
        obs_norm, ext_norm (RunningNormalizer): of the observation and of the extrinsic state (SI units).
        encoder (nn.Module, optional): intrinsic parameters to latent; None where the actor reads no latent.
        intrinsic_estimator, extrinsic_estimator (NormalizedEstimator or EstimatorModule, optional): of the latent, of
            the extrinsic state; an :class:`EstimatorModule` of both may be given as both. None for what the actor does
            not read.
        backbone (ActorBackbone): the actor's mean action.
        exploration (Exploration): the actor's standard deviations.
        critic (AsymmetricCritic): the value.
        estimator_inputs (sequence of NestedKey): inputs of the extrinsic estimator beside the history, one for each of
            its ``side_norms``.
        critic_inputs (sequence of NestedKey): last inputs of the critic, one for each of its ``input_norms``.
        keys (NetworkKeys): names of the other entries.

    The ``state_dict`` holds parameters and the normalisers' statistics, but not the two attributes: set them beside it.

    Attributes:
        command_range (CommandRange or None): range to which the deployed policy's commands are clipped; initially None.
        is_teacher (bool): whether it acts on privileged information alone, its estimators untrained; initially False.

    Example:
        >>> from torchrl.data import Composite, Unbounded
        >>> from torchrl_atr.modules import make_networks
        >>> privileged = Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,)))
        >>> spec = Composite(observation=Unbounded((5,)), history=Unbounded((4, 5)), privileged=privileged)
        >>> networks = make_networks(spec, Unbounded((2,)))
        >>> networks.deployed_policy()(spec.expand(8).rand())["action"].shape
        torch.Size([8, 2])
    """

    def __init__(
        self,
        *,
        obs_norm: RunningNormalizer,
        ext_norm: RunningNormalizer,
        encoder: nn.Module | None = None,
        intrinsic_estimator: NormalizedEstimator | EstimatorModule | None = None,
        extrinsic_estimator: NormalizedEstimator | EstimatorModule | None = None,
        backbone: ActorBackbone,
        exploration: Exploration,
        critic: AsymmetricCritic,
        estimator_inputs: Sequence[NestedKey] = (),
        critic_inputs: Sequence[NestedKey] = (),
        keys: NetworkKeys | None = None,
    ) -> None:
        super().__init__()
        self.obs_norm, self.ext_norm = obs_norm, ext_norm
        self.encoder = encoder
        self.intrinsic_estimator, self.extrinsic_estimator = intrinsic_estimator, extrinsic_estimator
        self.backbone = backbone
        self.exploration = exploration
        self.critic = critic
        self.estimator_inputs, self.critic_inputs = tuple(estimator_inputs), tuple(critic_inputs)
        self.keys = keys or NetworkKeys()
        self.command_range: CommandRange | None = None
        self.is_teacher = False

    @property
    def encoder_module(self) -> TensorDictModule | None:
        """Encoder: intrinsic parameters (*B, I) to the latent z (*B, L); None without one, as the estimators."""
        if self.encoder is None:
            return None
        return TensorDictModule(self.encoder, in_keys=[self.keys.intrinsic], out_keys=[self.keys.latent])

    @property
    def intrinsic_estimator_module(self) -> TensorDictModuleBase | None:
        """Intrinsic estimator: history (*B, H, D), or what it declares, to the estimated latent (*B, L)."""
        if self.intrinsic_estimator is None or isinstance(self.intrinsic_estimator, TensorDictModuleBase):
            return self.intrinsic_estimator
        keys = self.keys
        return TensorDictModule(self.intrinsic_estimator, in_keys=[keys.history], out_keys=[keys.intrinsic_estimate])

    @property
    def extrinsic_estimator_module(self) -> TensorDictModuleBase | None:
        """Extrinsic estimator: history (*B, H, D) and ``estimator_inputs`` to the extrinsic state (*B, E), SI units."""
        if self.extrinsic_estimator is None or isinstance(self.extrinsic_estimator, TensorDictModuleBase):
            return self.extrinsic_estimator
        in_keys = [self.keys.history, *self.estimator_inputs]
        return TensorDictModule(self.extrinsic_estimator, in_keys=in_keys, out_keys=[self.keys.extrinsic_estimate])

    @property
    def estimator_modules(self) -> list[TensorDictModuleBase]:
        """Both estimators, or those that there are; the one that has both roles alone."""
        shared = self.intrinsic_estimator is self.extrinsic_estimator
        found = [self.intrinsic_estimator_module, *[self.extrinsic_estimator_module] * (not shared)]
        return [module for module in found if module is not None]

    @property
    def critic_module(self) -> ValueOperator:
        """Critic: observation, both privileged entries, if used, and ``critic_inputs`` to the state value (*B, 1)."""
        keys = self.keys
        privileged = [] if self.critic.extrinsic_norm is None else [keys.intrinsic, keys.extrinsic]
        in_keys = [keys.observation, *privileged, *self.critic_inputs]
        return ValueOperator(self.critic, in_keys=in_keys, out_keys=[keys.state_value])

    def training_actor(self, source: ActSourceName = "privileged") -> ProbabilisticActor:
        """Return the actor that the loss differentiates.

        With ``estimated`` and ``mixed`` it reads the estimates (and the mask) that the rollout recorded
        instead of computing them again: the importance ratio of the first minibatch is one even after the
        estimators moved.
        """
        check_source(source)
        return self._actor(source, *([] if source == "estimated" else self._encoders))

    def rollout_policy(self, source: ActSourceName = "privileged", student_fraction: float = 0.5) -> ProbabilisticActor:
        """Return the actor for collection; it computes and records the inputs of :meth:`training_actor`.

        Estimators with a hidden state always run, since they are trained on the states that they have recorded.

        Args:
            source (str): ``privileged``, ``estimated`` or ``mixed``.
            student_fraction (float): with ``mixed``, the share of robots that act on the estimates.

        Raises:
            InputError: if a teacher is to act on estimates.
        """
        check_source(source)
        estimators = self.estimator_modules
        if source == "privileged":
            return self._actor(source, *self._encoders, *(each for each in estimators if state_keys(each)))
        if self.is_teacher:
            raise InputError(
                "this policy is a teacher, which acts on privileged information: its estimators were not trained. "
                "Measure it with `torchrl-atr evaluate --act-source privileged` (here: source='privileged'); to deploy "
                "it, train a student: `torchrl-atr train --preset rma --from RUN`, docs/adaptation.md"
            )
        if source == "estimated":
            return self._actor(source, *estimators)
        assign = AssignActSource(student_fraction, reference=self.keys.observation, student=self.keys.student)
        return self._actor(source, *self._encoders, *estimators, assign)

    def deployed_policy(self, act_source: ActSourceName = "estimated") -> TensorDictModuleBase:
        """Return the policy for deployment: it reads history, observation and ``estimator_inputs``, nothing else.

        With a :attr:`command_range` it clips commands to that. ``act_source="privileged"`` lets it act on the truth, to
        tell errors of estimates from those of control.

        It shares the networks and their mode: call ``eval()`` on networks that were trained with dropout or batch
        statistics before they are deployed. Those of :func:`torchrl_atr.training.load_run` and
        ``Learner.deployed`` are in eval mode.
        """
        policy = self.rollout_policy(act_source)
        return policy if self.command_range is None else CommandClippedPolicy(policy, self.command_range, self.keys)

    def update_normalizers(self, tensordict: TensorDictBase) -> None:
        """Merge a batch's observations, extrinsic states and further inputs into the running statistics.

        Call it between iterations: after the epochs on a batch, before the next rollout.

        Args:
            tensordict (TensorDictBase): holds them, (*B, D) each.

        Raises:
            KeyError: if it lacks one; names it.
        """
        normalizers: list[tuple[NestedKey, Any]] = [
            (self.keys.observation, self.obs_norm),
            (self.keys.extrinsic, self.ext_norm),
            *zip(self.estimator_inputs, getattr(self.extrinsic_estimator, "side_norms", ())),
            *zip(self.critic_inputs, self.critic.input_norms),
        ]
        for key, norm in normalizers:
            value = tensordict.get(key, None)
            if value is None:
                raise KeyError(f"the batch lacks {key!r}, which is normalised; keep it, or rename it in NetworkKeys")
            norm.update(value)

    def policy_parameters(self) -> Iterator[nn.Parameter]:
        """Iterate over the parameters that PPO and the ROA term train: encoder, actor, exploration and critic."""
        trained = (self.encoder, self.backbone, self.exploration, self.critic)
        return chain.from_iterable(network.parameters() for network in trained if network is not None)

    def estimator_parameters(self) -> Iterator[nn.Parameter]:
        """Iterate over the parameters that the estimator losses train: those of the estimators."""
        return chain.from_iterable(estimator.parameters() for estimator in self.estimator_modules)

    @property
    def _encoders(self) -> list[TensorDictModule]:
        return [] if (module := self.encoder_module) is None else [module]

    def _actor(self, source: ActSourceName, *front: Any) -> ProbabilisticActor:
        keys, reads = self.keys, [name for name in ("latent", "extrinsic") if name in self.backbone.reads]
        act_source = ActSource(
            source,
            reads=reads,
            latent=keys.latent,
            extrinsic=keys.extrinsic,
            intrinsic_estimate=keys.intrinsic_estimate,
            extrinsic_estimate=keys.extrinsic_estimate,
            student=keys.student,
            act_intrinsic=keys.act_intrinsic,
            act_extrinsic=keys.act_extrinsic,
        )
        scales = self._scales(source)
        actor = make_actor(
            self.backbone,
            self.exploration,
            *([*front, act_source] if reads else []),
            *scales,
            observation=keys.observation,
            history=keys.history,
            act_intrinsic=keys.act_intrinsic,
            act_extrinsic=keys.act_extrinsic,
            act_scales=[key for scale in scales for key in scale.out_keys],
            action=keys.action,
        )
        return actor if self.training else actor.eval()

    def _scales(self, source: ActSourceName) -> list[ActScale]:
        keys = self.keys
        rows = {
            "latent": (keys.intrinsic_scale, keys.act_intrinsic, keys.act_intrinsic_scale),
            "extrinsic": (keys.extrinsic_scale, keys.act_extrinsic, keys.act_extrinsic_scale),
        }
        return [
            ActScale(source, scale=scale, chosen=chosen, student=keys.student, act_scale=act_scale)
            for name, (scale, chosen, act_scale) in rows.items()
            if f"{name}_scale" in self.backbone.reads
        ]

"""PPO with regularised online adaptation: the paper's Eqs. 15-16 on TorchRL's clipped PPO loss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModule, TensorDictParams, dispatch
from torch import Tensor, nn
from torchrl.objectives import ClipPPOLoss

from torchrl_atr._torchrl_private import ExtensibleClipPPOLoss
from torchrl_atr.objectives.regression import check_scale, regression

ADAPTATION_NETWORKS = ("encoder_network", "intrinsic_estimator_network", "extrinsic_estimator_network")
_RENAME = "Give it that out_key, or rename it: loss.set_keys(latent=..., latent_estimate=..., extrinsic_estimate=...)."


class ROAClipPPOLoss(ExtensibleClipPPOLoss):
    r"""Clipped PPO loss with the three regression terms of regularised online adaptation (Eqs. 15-16).

    .. math::
        L^{int} = \|\hat z - sg[z]\|^2 + \lambda \|sg[\hat z] - z\|^2, \qquad
        L^{ext} = \|(\hat x - x) / \sigma\|^2

    ======================  ==============================================  =========================
    key                     value (sum over features, mean over samples)    gradient goes to
    ======================  ==============================================  =========================
    ``loss_objective`` ...  as in :class:`~torchrl.objectives.ClipPPOLoss`  actor and encoder; critic
    ``loss_intrinsic``      ``intrinsic_coeff * ||zhat - sg[z]||^2``        intrinsic estimator only
    ``loss_roa``            ``roa_coeff * ||sg[zhat] - z||^2``              encoder only
    ``loss_extrinsic``      ``extrinsic_coeff * ||(xhat - x) / std||^2``    extrinsic estimator only
    ``loss_smoothness``     ``smoothness_coeff * ||mu_t - mu_{t-1}||^2``    actor and encoder; only if asked for
    ``loss_extrinsic_X``    an estimator's own loss ``X``                   that estimator only
    ======================  ==============================================  =========================

    Estimators that write standard deviations are trained by likelihood; one with a hidden state needs sequences (n, T).
    Its own losses, from ``estimate_and_losses`` as :class:`~torchrl_atr.modules.EstimatorModule` has it, are called
    ``loss_intrinsic_X``, ``loss_extrinsic_X``, or ``loss_estimator_X`` if one network is both estimators.

    Three entry points: :meth:`forward` returns every term (what a TorchRL trainer sums);
    :meth:`policy_loss` the PPO terms and ``loss_roa``; :meth:`adaptation_loss` the two estimator terms.
    With the last two a recipe trains the estimators for its own number of epochs. Detached diagnostics:
    ``latent_error`` (RMS norm of zhat - z) and ``extrinsic_error`` (RMS over all components of the error in
    units of std, so 1 is as good as the mean); ``latent_calibration`` and ``extrinsic_calibration`` with scales.

    The encoder network must share its parameters with the encoder inside the actor: PPO and ``loss_roa``
    then add up in it, and no parameter is listed twice. Every network runs once in a call: all terms read its pass.

    Args:
        actor_network (ProbabilisticTensorDictSequential): the actor that is trained; it may contain the encoder.
        critic_network (TensorDictModule): the critic.
        encoder_network (TensorDictModule): writes the latent z, (*B, L).
        intrinsic_estimator_network (TensorDictModule): writes zhat, (*B, L).
        extrinsic_estimator_network (TensorDictModule): writes xhat, (*B, E), in its target's units; may be the same.

    Keyword Args:
        roa_coeff (float): the paper's lambda. Defaults to 0.2.
        intrinsic_coeff, extrinsic_coeff (float): weights of the estimator terms. Default to 1.
        smoothness_coeff (float): weight of the change of the mean action from the step before, which the data must
            then hold as ``previous_mean`` (:func:`previous_means`). Defaults to 0: no such term, whatever a
            schedule says later.
        extrinsic_scale (Tensor or nn.Module with ``std``, optional): per-component std that divides the
            extrinsic error (question A25); a :class:`~torchrl_atr.modules.RunningNormalizer` is read at
            every call. None is the plain sum of the paper.
        **ppo_kwargs: passed to :class:`~torchrl.objectives.ClipPPOLoss`.

    Raises:
        ValueError: if a coefficient is negative or a scale is not positive.
        KeyError: if a network does not write the key that the loss reads (rename with ``set_keys``).

    The coefficients can be scheduled by assignment: ``loss.roa_coeff = 0.1``.

    Example:
        >>> import torch
        >>> from torchrl.data import Composite, Unbounded
        >>> from torchrl_atr.modules import make_networks
        >>> privileged = Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,)))
        >>> spec = Composite(observation=Unbounded((5,)), history=Unbounded((4, 5)), privileged=privileged)
        >>> nets = make_networks(spec, Unbounded((2,)), estimator="mlp")
        >>> loss = ROAClipPPOLoss(
        ...     nets.training_actor(),
        ...     nets.critic_module,
        ...     nets.encoder_module,
        ...     nets.intrinsic_estimator_module,
        ...     nets.extrinsic_estimator_module,
        ...     extrinsic_scale=nets.ext_norm,
        ... )
        >>> losses = loss.adaptation_loss(spec.expand(8).rand())
        >>> sorted(key for key in losses.keys() if key.startswith("loss_"))
        ['loss_extrinsic', 'loss_intrinsic']
    """

    @dataclass
    class _AcceptedKeys(ClipPPOLoss._AcceptedKeys):
        """Keys of ClipPPOLoss and those of the regression terms; all can be changed with ``set_keys``.

        Attributes:
            latent (NestedKey): what the encoder writes.
            latent_estimate (NestedKey): what the intrinsic estimator writes, and where a recorded zhat is
                read.
            extrinsic (NestedKey): the true extrinsic state in the data.
            extrinsic_estimate (NestedKey): what the extrinsic estimator writes.
            latent_estimate_scale, extrinsic_estimate_scale (NestedKey): standard deviations that estimators may write.
            previous_mean (NestedKey): the mean action of the step before, (*B, A).
        """

        latent: NestedKey = ("latent", "intrinsic")
        latent_estimate: NestedKey = ("estimate", "intrinsic")
        extrinsic: NestedKey = ("privileged", "extrinsic")
        extrinsic_estimate: NestedKey = ("estimate", "extrinsic")
        latent_estimate_scale: NestedKey = ("estimate", "intrinsic_scale")
        extrinsic_estimate_scale: NestedKey = ("estimate", "extrinsic_scale")
        previous_mean: NestedKey = "previous_mean"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys  # type: ignore[assignment]
    _schedulable_buffers = frozenset({"roa_coeff", "intrinsic_coeff", "extrinsic_coeff", "smoothness_coeff"})

    encoder_network: TensorDictModule
    encoder_network_params: TensorDictParams | None
    target_encoder_network_params: TensorDictParams | None
    intrinsic_estimator_network: TensorDictModule
    intrinsic_estimator_network_params: TensorDictParams | None
    target_intrinsic_estimator_network_params: TensorDictParams | None
    extrinsic_estimator_network: TensorDictModule
    extrinsic_estimator_network_params: TensorDictParams | None
    target_extrinsic_estimator_network_params: TensorDictParams | None

    roa_coeff: Tensor
    intrinsic_coeff: Tensor
    extrinsic_coeff: Tensor
    smoothness_coeff: Tensor
    extrinsic_norm: nn.Module | None
    extrinsic_std: Tensor | None

    def __init__(
        self,
        actor_network: ProbabilisticTensorDictSequential,
        critic_network: TensorDictModule,
        encoder_network: TensorDictModule,
        intrinsic_estimator_network: TensorDictModule,
        extrinsic_estimator_network: TensorDictModule,
        *,
        roa_coeff: float = 0.2,
        intrinsic_coeff: float = 1.0,
        extrinsic_coeff: float = 1.0,
        smoothness_coeff: float = 0.0,
        extrinsic_scale: Tensor | nn.Module | None = None,
        **ppo_kwargs: Any,
    ) -> None:
        super().__init__(actor_network, critic_network, **ppo_kwargs)
        networks = [encoder_network, intrinsic_estimator_network, extrinsic_estimator_network]
        shared = extrinsic_estimator_network is intrinsic_estimator_network  # its parameters are listed once
        for name, network in zip(ADAPTATION_NETWORKS, networks[: 2 if shared else 3]):
            self._add_network(name, network)
        self._estimators = ADAPTATION_NETWORKS[1 : 2 if shared else 3]
        device = next(self.parameters()).device
        values = roa_coeff, intrinsic_coeff, extrinsic_coeff, smoothness_coeff
        for name, value in zip(("roa_coeff", "intrinsic_coeff", "extrinsic_coeff", "smoothness_coeff"), values):
            if value < 0:
                raise ValueError(f"{name} must be >= 0, got {value}; 0 switches the term off.")
            self.register_coeff_buffer(name, float(value), device=device)
        self.extrinsic_norm, std = check_scale(extrinsic_scale)
        self.register_buffer("extrinsic_std", std)
        self._smooth = smoothness_coeff > 0
        self._renew_keys()  # the parent's constructor listed them before these networks existed

    @property
    def extrinsic_scale(self) -> Tensor | None:
        """Standard deviation that divides the extrinsic error, (E,), or None."""
        return self.extrinsic_std if self.extrinsic_norm is None else cast(Tensor, self.extrinsic_norm.std)

    def further_in_keys(self) -> list[NestedKey]:
        """Return the inputs of the adaptation networks, and their targets."""
        keys = [*self._adaptation_inputs(), self.tensor_keys.extrinsic]
        return keys + [self.tensor_keys.previous_mean] * getattr(self, "_smooth", False)

    def _adaptation_inputs(self) -> list[NestedKey]:
        """Return what the adaptation networks read, and the estimators' own losses; nothing before there are any."""
        found = (getattr(self, name, None) for name in ADAPTATION_NETWORKS)
        networks = [network for network in found if network is not None]
        return [key for network in networks for key in [*network.in_keys, *getattr(network, "loss_in_keys", ())]]

    def further_out_keys(self) -> list[NestedKey]:
        """Return the three regression terms, the two diagnostics, and ``loss_smoothness`` where it counts."""
        ours = ["loss_intrinsic", "loss_roa", "loss_extrinsic", "latent_error", "extrinsic_error"]
        return [*ours, *["loss_smoothness"] * self._smooth]

    @property
    def policy_in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`policy_loss` reads if advantages and zhat are recorded; masks and value are optional."""
        keys = self.tensor_keys
        networks = (self.actor_network, self.critic_network, self.encoder_network)
        recorded = [keys.action, keys.sample_log_prob, keys.advantage, keys.value_target, keys.value]
        recorded += [keys.latent_estimate, *self._mask_keys] + [keys.previous_mean] * self._smooth
        return [*(key for network in networks for key in network.in_keys), *recorded]

    @property
    def adaptation_in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`adaptation_loss` reads; masks are optional."""
        return [*self._adaptation_inputs(), self.tensor_keys.extrinsic, *self._mask_keys]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return every term: PPO, ``loss_roa`` and both estimator losses, with diagnostics."""
        acted = self._act(tensordict)
        latent = self._latent_of(acted)
        adaptation, estimate = self._adaptation_terms(tensordict, latent)
        out = super().forward(acted)
        out.update(self._roa_terms(tensordict, latent, estimate))
        out.update(adaptation)
        out.update(self._smoothness_terms(acted))
        return out

    def policy_loss(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the PPO terms, ``loss_roa`` and ``loss_smoothness``: what the policy's optimiser minimises.

        zhat is read from ``tensordict`` if it was recorded there (the rollout did, or the recipe computed
        it once for the whole batch), else computed without gradient.
        """
        acted = self._act(tensordict)
        estimate = tensordict.get(self.tensor_keys.latent_estimate, None)
        if estimate is None:
            with torch.no_grad():
                estimate = self._latent_estimate(tensordict)
        out = super().forward(acted)
        out.update(self._roa_terms(tensordict, self._latent_of(acted), estimate))
        out.update(self._smoothness_terms(acted))
        return out

    def adaptation_loss(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return ``loss_intrinsic``, ``loss_extrinsic``, estimators' own losses and diagnostics: what trains them."""
        with torch.no_grad():
            latent = self._latent(tensordict)
        return TensorDict(self._adaptation_terms(tensordict, latent)[0])

    def _latent_of(self, acted: TensorDictBase) -> Tensor:
        """Return the latent that the actor has computed, or compute it if the actor does not."""
        key = self.tensor_keys.latent
        return acted.get(key) if unravel_key(key) in self.actor_network.out_keys else self._latent(acted)

    def _smoothness_terms(self, acted: TensorDictBase) -> dict[str, Tensor]:
        if not self._smooth:
            return {}
        previous = acted.get(self.tensor_keys.previous_mean, None)
        if previous is None:
            raise KeyError(
                f"smoothness_coeff needs {self.tensor_keys.previous_mean!r} in the data: the mean action of the step "
                "before, as previous_means(batch) gives it; rename it with loss.set_keys(previous_mean=...)."
            )
        change = (self._distribution(acted).mean - previous).square().sum(-1)
        return {"loss_smoothness": self._reduced(self.smoothness_coeff * change, acted)}

    def _roa_terms(self, tensordict: TensorDictBase, latent: Tensor, estimate: Tensor) -> dict[str, Tensor]:
        distance = (estimate.detach() - latent).square().sum(-1)
        return {"loss_roa": self._reduced(self.roa_coeff * distance, tensordict)}

    def _adaptation_terms(self, tensordict: TensorDictBase, latent: Tensor) -> tuple[dict[str, Tensor], Tensor]:
        """Return the terms of the estimators, and zhat."""
        keys = self.tensor_keys
        target = tensordict.get(keys.extrinsic, None)
        if target is None:
            raise KeyError(
                f"No extrinsic target {keys.extrinsic!r} in the data; "
                "name the entry that holds it with loss.set_keys(extrinsic=...)."
            )
        written, terms = self._estimate(tensordict)
        zhat, z_scale = (written.get(key, None) for key in (keys.latent_estimate, keys.latent_estimate_scale))
        xhat, x_scale = (written.get(key, None) for key in (keys.extrinsic_estimate, keys.extrinsic_estimate_scale))
        intrinsic, z_error, z_calibration = regression(zhat, latent.detach(), None, z_scale)
        extrinsic, x_error, x_calibration = regression(xhat, target, self.extrinsic_scale, x_scale)
        calibrations = {"latent_calibration": z_calibration, "extrinsic_calibration": x_calibration}
        out = {
            "loss_intrinsic": self._reduced(self.intrinsic_coeff * intrinsic, tensordict),
            "loss_extrinsic": self._reduced(self.extrinsic_coeff * extrinsic, tensordict),
            **{name: self._reduced(value, tensordict) for name, value in terms.items()},
            "latent_error": z_error.square().sum(-1).mean().sqrt(),
            "extrinsic_error": x_error.square().mean().sqrt(),
        }
        return out | {name: value for name, value in calibrations.items() if value is not None}, zhat

    def _estimate(self, tensordict: TensorDictBase) -> tuple[TensorDictBase, dict[str, Tensor]]:
        """Run the estimators, each once; return what they write, and their own losses by name, (*B,) each."""
        wanted = [[self.tensor_keys.latent_estimate], [self.tensor_keys.extrinsic_estimate]]
        shared, written, terms = len(self._estimators) == 1, tensordict.empty(), {}
        for name, keys in zip(self._estimators, [wanted[0] + wanted[1]] if shared else wanted):
            ran, own = self._run_all(name, tensordict, keys, _RENAME)
            written.update(ran)
            role = "estimator" if shared else name.split("_")[0]
            terms.update({f"loss_{role}_{loss}": value for loss, value in own.items()})
        return written, terms

    def _latent(self, tensordict: TensorDictBase) -> Tensor:
        return self._run("encoder_network", self.tensor_keys.latent, tensordict, _RENAME)

    def _latent_estimate(self, tensordict: TensorDictBase) -> Tensor:
        return self._run("intrinsic_estimator_network", self.tensor_keys.latent_estimate, tensordict, _RENAME)

"""PPO with regularised online adaptation: the paper's Eqs. 15-16 on TorchRL's clipped PPO loss."""

from __future__ import annotations

from typing import Any, cast

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModule, TensorDictParams, dispatch
from torch import Tensor, nn

from torchrl_atr._torchrl_private import ExtensibleClipPPOLoss
from torchrl_atr.objectives.keys import ROAKeys
from torchrl_atr.objectives.regression import check_scale, regression

ADAPTATION_NETWORKS = ("encoder_network", "intrinsic_estimator_network", "extrinsic_estimator_network")
Terms = dict[str, Tensor]
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

    An actor that reads no latent has neither encoder nor intrinsic estimator, one that reads no extrinsic state no
    extrinsic estimator: these networks are None, and there are no terms and no diagnostics of them.

    Args:
        actor_network (ProbabilisticTensorDictSequential): the actor that is trained; it may contain the encoder.
        critic_network (TensorDictModule): the critic.
        encoder_network (TensorDictModule, optional): writes the latent z, (*B, L).
        intrinsic_estimator_network (TensorDictModule, optional): writes zhat, (*B, L).
        extrinsic_estimator_network (TensorDictModule, optional): writes xhat, (*B, E), in its target's units; may be
            the same.

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
        ValueError: for a negative coefficient, a scale that is not positive, an encoder without intrinsic estimator.
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

    _AcceptedKeys = ROAKeys
    default_keys = ROAKeys
    tensor_keys: ROAKeys  # type: ignore[assignment]
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
        encoder_network: TensorDictModule | None = None,
        intrinsic_estimator_network: TensorDictModule | None = None,
        extrinsic_estimator_network: TensorDictModule | None = None,
        *,
        roa_coeff: float = 0.2,
        intrinsic_coeff: float = 1.0,
        extrinsic_coeff: float = 1.0,
        smoothness_coeff: float = 0.0,
        extrinsic_scale: Tensor | nn.Module | None = None,
        **ppo_kwargs: Any,
    ) -> None:
        super().__init__(actor_network, critic_network, **ppo_kwargs)
        given = encoder_network, intrinsic_estimator_network, extrinsic_estimator_network
        if (given[0] is None) != (given[1] is None):
            raise ValueError("encoder_network and intrinsic_estimator_network belong together: give both, or neither.")
        networks = {name: network for name, network in zip(ADAPTATION_NETWORKS, given) if network is not None}
        if given[1] is given[2]:  # its parameters are listed once
            networks.pop(ADAPTATION_NETWORKS[2], None)
        for name, network in networks.items():
            self._add_network(name, network)
        self._estimators = tuple(name for name in ADAPTATION_NETWORKS[1:] if name in networks)
        self._reads_latent, self._reads_extrinsic = given[1] is not None, given[2] is not None
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
        keys = self._adaptation_inputs() + [self.tensor_keys.extrinsic] * getattr(self, "_reads_extrinsic", False)
        return keys + [self.tensor_keys.previous_mean] * getattr(self, "_smooth", False)

    def _adaptation_inputs(self) -> list[NestedKey]:
        """Return what the adaptation networks read, and the estimators' own losses; nothing before there are any."""
        found = (getattr(self, name, None) for name in ADAPTATION_NETWORKS)
        networks = [network for network in found if network is not None]
        return [key for network in networks for key in [*network.in_keys, *getattr(network, "loss_in_keys", ())]]

    def further_out_keys(self) -> list[NestedKey]:
        """Return regression terms, errors and ``loss_smoothness``; no calibrations, no losses of estimators' own."""
        ours = ["loss_intrinsic", "loss_roa", "latent_error"] * self._reads_latent
        ours += ["loss_extrinsic", "extrinsic_error"] * self._reads_extrinsic
        return [*ours, *["loss_smoothness"] * self._smooth]

    @property
    def policy_in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`policy_loss` reads if advantages and zhat are recorded; masks and value are optional."""
        keys = self.tensor_keys
        encoder = [self.encoder_network] if self._reads_latent else []
        networks = [self.actor_network, self.critic_network, *encoder]
        recorded = [keys.action, keys.sample_log_prob, keys.advantage, keys.value_target, keys.value]
        recorded += [keys.latent_estimate] * self._reads_latent + [*self._mask_keys]
        recorded += [keys.previous_mean] * self._smooth
        return [*(key for network in networks for key in network.in_keys), *recorded]

    @property
    def adaptation_in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`adaptation_loss` reads; masks are optional."""
        targets = [self.tensor_keys.extrinsic] * self._reads_extrinsic
        return [*self._adaptation_inputs(), *targets, *self._mask_keys]

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
        if estimate is None and self._reads_latent:
            with torch.no_grad():
                estimate = self._latent_estimate(tensordict)
        out = super().forward(acted)
        out.update(self._roa_terms(tensordict, self._latent_of(acted), estimate))
        out.update(self._smoothness_terms(acted))
        return out

    def adaptation_loss(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return ``loss_intrinsic``, ``loss_extrinsic``, estimators' own losses and diagnostics: what trains them."""
        with torch.no_grad():
            latent = self._latent(tensordict) if self._reads_latent else None
        return TensorDict(self._adaptation_terms(tensordict, latent)[0])

    def _latent_of(self, acted: TensorDictBase) -> Tensor | None:
        """Return the latent that the actor has computed, or compute it if the actor does not; None without one."""
        key = self.tensor_keys.latent
        if not self._reads_latent:
            return None
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

    def _roa_terms(self, tensordict: TensorDictBase, latent: Tensor | None, estimate: Tensor | None) -> Terms:
        if latent is None or estimate is None:
            return {}
        distance = (estimate.detach() - latent).square().sum(-1)
        return {"loss_roa": self._reduced(self.roa_coeff * distance, tensordict)}

    def _adaptation_terms(self, tensordict: TensorDictBase, latent: Tensor | None) -> tuple[Terms, Tensor | None]:
        """Return the terms of the estimators, and zhat."""
        keys = self.tensor_keys
        target = tensordict.get(keys.extrinsic, None)
        if self._reads_extrinsic and target is None:
            raise KeyError(
                f"No extrinsic target {keys.extrinsic!r} in the data; "
                "name the entry that holds it with loss.set_keys(extrinsic=...)."
            )
        written, own = self._estimate(tensordict)
        zhat, z_scale = (written.get(key, None) for key in (keys.latent_estimate, keys.latent_estimate_scale))
        xhat, x_scale = (written.get(key, None) for key in (keys.extrinsic_estimate, keys.extrinsic_estimate_scale))
        terms: Terms = {}
        reports: dict[str, Tensor | None] = {}
        if latent is not None:
            loss, error, reports["latent_calibration"] = regression(zhat, latent.detach(), None, z_scale)
            terms["loss_intrinsic"] = self._reduced(self.intrinsic_coeff * loss, tensordict)
            reports["latent_error"] = error.square().sum(-1).mean().sqrt()
        if self._reads_extrinsic:
            loss, error, reports["extrinsic_calibration"] = regression(xhat, target, self.extrinsic_scale, x_scale)
            terms["loss_extrinsic"] = self._reduced(self.extrinsic_coeff * loss, tensordict)
            reports["extrinsic_error"] = error.square().mean().sqrt()
        terms |= {name: self._reduced(value, tensordict) for name, value in own.items()}
        return terms | {name: value for name, value in reports.items() if value is not None}, zhat

    def _estimate(self, tensordict: TensorDictBase) -> tuple[TensorDictBase, dict[str, Tensor]]:
        """Run the estimators, each once; return what they write, and their own losses by name, (*B,) each."""
        keys, written, terms = self.tensor_keys, tensordict.empty(), {}
        wanted = dict(zip(ADAPTATION_NETWORKS[1:], (keys.latent_estimate, keys.extrinsic_estimate)))
        shared = self._reads_latent and self._reads_extrinsic and len(self._estimators) == 1
        for name in self._estimators:
            ran, own = self._run_all(name, tensordict, list(wanted.values()) if shared else [wanted[name]], _RENAME)
            written.update(ran)
            role = "estimator" if shared else name.split("_")[0]
            terms.update({f"loss_{role}_{loss}": value for loss, value in own.items()})
        return written, terms

    def _latent(self, tensordict: TensorDictBase) -> Tensor:
        return self._run("encoder_network", self.tensor_keys.latent, tensordict, _RENAME)

    def _latent_estimate(self, tensordict: TensorDictBase) -> Tensor:
        return self._run("intrinsic_estimator_network", self.tensor_keys.latent_estimate, tensordict, _RENAME)

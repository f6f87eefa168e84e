"""TensorDict modules as estimators: normalised entries for them, estimates in the units of their targets from them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensordict import NestedKey, TensorDictBase, unravel_key, unravel_key_list
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn

from torchrl_atr.modules.estimators.normalized import beside
from torchrl_atr.modules.estimators.registry import EstimatorError
from torchrl_atr.modules.estimators.spec import EstimatorSpec
from torchrl_atr.modules.estimators.state import IS_INIT, state_keys
from torchrl_atr.modules.normalization import RunningNormalizer


class WindowModule(TensorDictModule):
    """TensorDict module of a network of histories: the further inputs are repeated beside each observation.

    It lets an estimator of tensors serve both roles.

    Args:
        net (nn.Module): maps (*B, H, D + S) to all estimates together, (*B, out_features).
        spec (EstimatorSpec): its role and sizes.

    Example:
        >>> from torchrl_atr.modules.estimators import get_estimator
        >>> spec = EstimatorSpec("both", (4, 5), {"intrinsic": 2, "extrinsic": 3})
        >>> WindowModule(get_estimator("mlp")((4, 5), 5), spec).out_keys
        [('estimate', 'intrinsic'), ('estimate', 'extrinsic')]
    """

    def __init__(self, net: nn.Module, spec: EstimatorSpec) -> None:
        super().__init__(
            _Window(net, list(spec.targets.values())),
            in_keys=[spec.keys.history, *spec.inputs],
            out_keys=spec.estimate_keys,
        )


class _Window(nn.Module):
    def __init__(self, net: nn.Module, sizes: list[int]) -> None:
        super().__init__()
        self.net, self.sizes = net, sizes

    def forward(self, history: Tensor, *inputs: Tensor) -> tuple[Tensor, ...]:
        return self.net(beside(history, inputs)).split(self.sizes, -1)


class EstimatorModule(TensorDictModuleBase):
    """Estimator that is a TensorDict module, between normalisers.

    It normalises what the estimator declares in ``in_keys``, and what its losses read in ``loss_in_keys``, runs it on
    these alone, and writes its estimates in the units of their targets, their scales and its next hidden state. All
    else that the estimator writes stays with it.

    Args:
        net (TensorDictModuleBase): the estimator.
        spec (EstimatorSpec): what it was made with.
        input_norm (RunningNormalizer): of one observation.
        output_norm (RunningNormalizer): of the extrinsic state.
        side_norms (mapping of NestedKey to RunningNormalizer): of the further inputs.

    Attributes:
        loss_in_keys (list of NestedKey): entries that its losses read beside its inputs.

    Raises:
        EstimatorError: if the estimator does not write its estimates, or reads privileged entries.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl_atr.modules.estimators import get_estimator
        >>> spec = EstimatorSpec("extrinsic", (4, 5), {"extrinsic": 3})
        >>> norms = RunningNormalizer(5), RunningNormalizer(3)
        >>> module = EstimatorModule(get_estimator("gaussian")(spec, trunk="mlp"), spec, *norms)
        >>> out = module(TensorDict(history=torch.zeros(7, 4, 5), batch_size=[7]))
        >>> out["estimate", "extrinsic"].shape, bool((out["estimate", "extrinsic_scale"] > 0).all())
        (torch.Size([7, 3]), True)
    """

    def __init__(
        self,
        net: TensorDictModuleBase,
        spec: EstimatorSpec,
        input_norm: RunningNormalizer,
        output_norm: RunningNormalizer,
        side_norms: Mapping[NestedKey, RunningNormalizer] | None = None,
    ) -> None:
        super().__init__()
        self.net, self.spec = net, spec
        self.input_norm, self.output_norm = input_norm, output_norm
        self.side_norms = nn.ModuleList((side_norms or {}).values())
        written = unravel_key_list(list(net.out_keys))
        missing = [key for key in spec.estimate_keys if unravel_key(key) not in written]
        if missing:
            raise EstimatorError(
                f"Estimator check 'out_keys' failed: they lack {missing[0]!r}; declare and write all of "
                "spec.estimate_keys, with the role's sizes spec.targets."
            )
        privileged = {unravel_key(key) for key in (spec.keys.intrinsic, spec.keys.extrinsic, spec.keys.latent)}
        forbidden = [key for key in unravel_key_list(list(net.in_keys)) if key in privileged or key[0] == "next"]
        if forbidden:
            raise EstimatorError(
                f"Estimator check 'in_keys' failed: {forbidden[0]!r} is not known where the policy is deployed; losses "
                "may read it: name it in loss_in_keys."
            )
        scales = [key for key in spec.scale_keys if unravel_key(key) in written]
        self.state_keys = state_keys(net)
        self.in_keys = list(net.in_keys)
        self.out_keys = [*spec.estimate_keys, *scales, *(("next", *_tuple(key)) for key in self.state_keys)]
        self.loss_in_keys = list(getattr(net, "loss_in_keys", ()))
        norms: dict[Any, RunningNormalizer] = {
            spec.keys.observation: input_norm,
            spec.next_observation_key: input_norm,
            spec.keys.history: input_norm,
            spec.keys.extrinsic: output_norm,
            **(side_norms or {}),
        }
        # a plain dict by the declared keys: no names in the state_dict, and no search at every step
        found = {unravel_key(key): norm for key, norm in norms.items()}
        self._norms = {key: found.get(unravel_key(key)) for key in [*self.in_keys, *self.loss_in_keys]}

    @property
    def writes_scale(self) -> bool:
        """True if every estimate has a standard deviation."""
        return all(key in self.out_keys for key in self.spec.scale_keys)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the estimates, their scales and the next hidden state into ``tensordict`` and return it."""
        return self._write(self._run(tensordict), tensordict)

    def estimate_and_losses(self, tensordict: TensorDictBase) -> tuple[TensorDictBase, dict[str, Tensor]]:
        """Return the estimates, and the estimator's own losses by name, (*B,) each, of a training pass.

        Args:
            tensordict (TensorDictBase): holds ``in_keys`` and ``loss_in_keys``; sequences (n, T) for an estimator with
                a hidden state, under ``set_recurrent_mode(True)``.
        """
        ran = self._run(tensordict, self.loss_in_keys)
        losses = self.net.losses(ran) if hasattr(self.net, "losses") else {}
        return self._write(ran, tensordict.empty()), losses

    def _run(self, tensordict: TensorDictBase, further: list[NestedKey] | None = None) -> TensorDictBase:
        net_input = tensordict.empty()
        for key in [*self.in_keys, *(further or ())]:
            value = tensordict.get(key, None)
            if value is None:
                raise KeyError(self._missing(key))
            norm = self._norms[key]
            net_input.set(key, value if norm is None else norm(value))
        return self.net(net_input)

    def _write(self, ran: TensorDictBase, tensordict: TensorDictBase) -> TensorDictBase:
        for key in self.out_keys:
            value = ran.get(key)
            if key == self.spec.keys.extrinsic_estimate:
                value = self.output_norm.inverse(value)
            elif key == self.spec.keys.extrinsic_scale:
                value = value * self.output_norm.std
            tensordict.set(key, value)
        return tensordict

    def _missing(self, key: NestedKey) -> str:
        if key == IS_INIT or key in self.state_keys:
            return (
                f"the estimator reads {key!r}, the memory of an episode, which is not there; roll out in "
                "with_state(env, policy), or collect the batch there"
            )
        return f"the estimator reads {key!r}, which is not there; keep it, or name it as NetworkKeys does"


def _tuple(key: NestedKey) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)

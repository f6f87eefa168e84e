"""Schedules of loss coefficients over the progress of a run, and of a learning rate by the policy's divergence."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import LossModule
from torchrl.objectives.utils import KLAdaptiveLR

from torchrl_atr._torchrl_private import schedulable_buffers


class LinearSchedule:
    """Linear ramp of one schedulable coefficient of a loss over the progress of a run (question A23).

    The paper keeps lambda constant; the code it builds on ramps it from 0 to 0.1, which is ``LinearSchedule(loss)``.

    Args:
        loss (LossModule): the loss; the coefficient is set at once to ``start``.
        name (str): one of the loss's schedulable buffers. Defaults to ``"roa_coeff"``.
        start, end (float): values before and after the ramp. Default to 0 and 0.1.
        begin, until (float): progress at which the ramp begins and ends. Default to 0 and 1.

    Raises:
        ValueError: if the loss has no such coefficient, or not ``0 <= begin < until <= 1``.

    Example:
        >>> from torchrl.data import Composite, Unbounded
        >>> from torchrl_atr.modules import make_networks
        >>> from torchrl_atr.objectives import ROAClipPPOLoss
        >>> privileged = Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,)))
        >>> spec = Composite(observation=Unbounded((5,)), history=Unbounded((4, 5)), privileged=privileged)
        >>> nets = make_networks(spec, Unbounded((2,)), estimator="mlp")
        >>> estimators = nets.intrinsic_estimator_module, nets.extrinsic_estimator_module
        >>> loss = ROAClipPPOLoss(nets.training_actor(), nets.critic_module, nets.encoder_module, *estimators)
        >>> schedule = LinearSchedule(loss, "roa_coeff", 0.0, 0.1)
        >>> schedule.step(0.5), loss.roa_coeff
        (0.05, tensor(0.0500))
    """

    def __init__(
        self,
        loss: LossModule,
        name: str = "roa_coeff",
        start: float = 0.0,
        end: float = 0.1,
        begin: float = 0.0,
        until: float = 1.0,
    ) -> None:
        allowed = schedulable_buffers(loss)
        if name not in allowed:
            raise ValueError(f"{type(loss).__name__} has no coefficient {name!r}. Allowed: {', '.join(allowed)}.")
        if not 0.0 <= begin < until <= 1.0:
            raise ValueError(f"Need 0 <= begin < until <= 1, got begin={begin}, until={until}.")
        self.loss, self.name = loss, name
        self.start, self.end = float(start), float(end)
        self.begin, self.until = float(begin), float(until)
        self.step(0.0)

    def value(self, progress: float) -> float:
        """Return the coefficient at a progress in [0, 1]."""
        fraction = min(max((progress - self.begin) / (self.until - self.begin), 0.0), 1.0)
        return self.start + fraction * (self.end - self.start)

    def step(self, progress: float) -> float:
        """Set the coefficient for a progress in [0, 1] (frames so far / total frames) and return it."""
        self.progress = float(progress)
        value = self.value(self.progress)
        setattr(self.loss, self.name, value)
        return value

    def state_dict(self) -> dict[str, Any]:
        """Return the progress; the ramp itself is configuration."""
        return {"progress": self.progress}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the progress and set the coefficient that belongs to it."""
        self.step(state_dict["progress"])


class DeviceKLAdaptiveLR(KLAdaptiveLR):
    """Version of TorchRL's :class:`~torchrl.objectives.utils.KLAdaptiveLR` that decides on the divergence's device.

    The rate is one tensor beside the parameters, shared by all parameter groups and changed in place: nothing waits for
    a GPU, and a step can be part of a CUDA graph. A divergence that is not finite changes nothing.

    Args:
        optimizer (torch.optim.Optimizer): takes a tensor as its rate, as fused Adam does; one rate for all groups.
        target_kl (float): may be changed between steps by assignment.
        **bounds: ``factor``, ``min_lr`` and ``max_lr`` of :class:`~torchrl.objectives.utils.KLAdaptiveLR`.

    Attributes:
        rate (Tensor): the learning rate, a float32 scalar.

    Example:
        >>> weight = torch.nn.Parameter(torch.zeros(1))
        >>> schedule = DeviceKLAdaptiveLR(torch.optim.Adam([weight], lr=1e-3, fused=True), target_kl=0.01)
        >>> schedule.step(torch.tensor(0.05))
        >>> round(schedule.get_last_lr()[0], 6)
        0.000667
    """

    def __init__(self, optimizer: torch.optim.Optimizer, target_kl: float, **bounds: float) -> None:
        group = optimizer.param_groups[0]
        device = group["params"][0].device
        self.rate = torch.zeros((), device=device)
        self._target = torch.zeros((), device=device)
        super().__init__(optimizer, target_kl, **bounds)
        self.set_rate(float(group["lr"]))

    @property
    def target_kl(self) -> float:
        """Desired divergence of an update."""
        return self._target_kl

    @target_kl.setter
    def target_kl(self, value: float) -> None:
        self._target_kl = float(value)
        self._target.fill_(self._target_kl)

    @torch.no_grad()
    def step(self, kl: float | Tensor, hold: Tensor | None = None) -> None:
        """Adapt the rate to the divergence of the last update.

        Args:
            kl (float or Tensor): a scalar.
            hold (Tensor, optional): a bool scalar; where it is true the rate stays.
        """
        kl = torch.as_tensor(kl, device=self.rate.device)
        slower = torch.where(kl > 2.0 * self._target, 1.0 / self.factor, 1.0)
        faster = torch.where((kl > 0.0) & (kl < 0.5 * self._target), self.factor, 1.0)
        adapted = (self.rate * slower * faster).clamp(self.min_lr, self.max_lr)
        stays = ~kl.isfinite() if hold is None else hold | ~kl.isfinite()
        self.rate.copy_(torch.where(stays, self.rate, adapted))

    def exceeded(self, kl: Tensor, multiple: float) -> Tensor:
        """Return whether a divergence is more than ``multiple`` times the target, a bool scalar on its device."""
        return kl > multiple * self._target

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore a schedule; the rate is the optimizer's, which must be restored before."""
        super().load_state_dict(state_dict)
        self.set_rate(float(self.optimizer.param_groups[0]["lr"]))

    def set_rate(self, rate: float) -> None:
        """Set the rate of all parameter groups."""
        self.rate.fill_(rate)
        for group in self.optimizer.param_groups:
            group["lr"] = self.rate


def kl_divergence(terms: TensorDictBase) -> Tensor:
    """Return E[r - 1 - log r] for the importance ratio r: never negative, and far less noisy than E[-log r].

    Args:
        terms: of :class:`~torchrl.objectives.ClipPPOLoss`.

    Example:
        >>> from tensordict import TensorDict
        >>> kl_divergence(TensorDict(mean_ratio=torch.tensor(1.5), kl_approx=torch.tensor(0.5)))
        tensor(1.)
    """
    return (terms["mean_ratio"] - 1 + terms["kl_approx"]).detach()

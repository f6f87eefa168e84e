"""Transform that lets commands change at a limited rate."""

from __future__ import annotations

from typing import NoReturn

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs.transforms import Transform

from torchrl_atr._checks import check_key, check_number, check_pair
from torchrl_atr.envs.physics.engine import CONTROL_DT


def slew(command: Tensor, target: Tensor, step: Tensor) -> Tensor:
    """Move commands towards their targets, (..., C) each, by ``step`` per component, (C,), at most.

    Example:
        >>> slew(torch.zeros(2), torch.tensor([-2.0, 0.01]), torch.tensor([0.5, 0.5])).tolist()
        [-0.5, 0.009999999776482582]
    """
    return command + (target - command).clamp(-step, step)


class CommandSlew(Transform):
    """Transform that lets the command approach what is asked for at a limited rate, in place.

    It belongs behind what draws commands, such as :class:`CommandCurriculum`, and before what observes them: env,
    reward and policy know the limited command alone. A jump from -2 to 2 m/s asks for more acceleration than a rider
    survives; two of three falls of a policy that was trained with jumps come within two seconds of one.

    An episode starts with the command zero, except in rows whose transporter moves already: these have reached it. The
    transform has no state: the command in force is the step's own.

    Args:
        rates: largest change of speed and yaw rate, m/s² and rad/s².
        dt: control period, s.
        moving_key: bool entry of the reset, ``(*B, 1)``: whether the episode starts with part of the commanded speeds;
            None if none does.
        command_key: the command, ``(*B, 2)``, m/s and rad/s.

    Raises:
        ValueError: if a rate or the period is not positive, or a key is of the wrong kind.

    Example:
        >>> from tensordict import TensorDict
        >>> asked = TensorDict({"command": torch.tensor([[2.0, 0.01]])}, [1])
        >>> before = TensorDict({"command": torch.zeros(1, 2)}, [1])
        >>> CommandSlew((2.5, 1.5), dt=0.2)._step(before, asked)["command"].tolist()
        [[0.5, 0.009999999776482582]]
    """

    step_size: Tensor

    def __init__(
        self,
        rates: tuple[float, float],
        dt: float = CONTROL_DT,
        *,
        moving_key: NestedKey | None = None,
        command_key: NestedKey = "command",
    ) -> None:
        self.command_key = check_key("command_key", command_key)
        super().__init__(in_keys=[command_key], out_keys=[command_key])
        self.moving_key = check_key("moving_key", moving_key, optional=True)
        self.rates = check_pair("rates", rates, "two positive numbers (m/s², rad/s²)")
        step = torch.tensor(self.rates) * check_number("dt", dt, above=0.0)
        self.register_buffer("step_size", step, persistent=False)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        asked = tensordict_reset.get(self.command_key)
        moving = torch.zeros_like(asked[..., :1], dtype=torch.bool)
        if self.moving_key is not None:
            moving = tensordict_reset.get(self.moving_key).to(torch.bool).reshape(moving.shape)
        return tensordict_reset.set(self.command_key, asked.where(moving, 0.0))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        before, asked = (td.get(self.command_key) for td in (tensordict, next_tensordict))
        return next_tensordict.set(self.command_key, slew(before, asked, self.step_size.to(before)))

    def _call(self, next_tensordict: TensorDictBase) -> NoReturn:
        raise NotImplementedError(
            "CommandSlew only works on the reset and step of an environment: TransformedEnv(env, Compose(..., "
            "CommandSlew(...))). Remove it from the module or replay buffer."
        )

    forward = _call

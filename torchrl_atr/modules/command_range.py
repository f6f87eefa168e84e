"""Range of commands of a deployed policy: commands beyond it are clipped."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from torchrl_atr._checks import check_flag, check_number
from torchrl_atr._errors import InputError
from torchrl_atr._files import write_json
from torchrl_atr.modules.keys import NetworkKeys

COMMAND_RANGE_FILE = "command_range.json"
"""File of a run folder that holds its policy's :class:`CommandRange`; a run without one follows every command."""


@dataclass(frozen=True)
class CommandRange:
    """Bounds of speed, yaw rate and lateral acceleration, to which commands are clipped.

    Speed and yaw rate are clipped to their own bounds. If |v ω| is still too large, the yaw rate is reduced, down to
    ``least_yaw_rate``, and then the speed. Signs stay, and a command within the range stays as it is.

    Attributes:
        max_speed: of |c_v|, m/s.
        max_yaw_rate: of |c_ω|, rad/s.
        max_lateral_acceleration: of |c_v c_ω|, m/s²; None for no such bound.
        least_yaw_rate: lower bound to which a larger yaw rate is reduced before the speed, rad/s.
        forward_only: whether a negative speed is clipped to zero.

    Raises:
        InputError: for a bound that is not a number, or negative, or a ``forward_only`` that is no bool; names it.

    Example:
        >>> limits = CommandRange(max_speed=4.0, max_yaw_rate=1.0, max_lateral_acceleration=2.0)
        >>> limits(torch.tensor([[-6.0, 0.3], [4.0, 2.0]])).tolist()
        [[-4.0, 0.30000001192092896], [4.0, 0.5]]
    """

    max_speed: float
    max_yaw_rate: float
    max_lateral_acceleration: float | None = None
    least_yaw_rate: float = 0.0
    forward_only: bool = False

    def __post_init__(self) -> None:
        for name in ("max_speed", "max_yaw_rate", "least_yaw_rate"):
            check_number(name, getattr(self, name), low=0.0)
        if self.max_lateral_acceleration is not None:
            check_number("max_lateral_acceleration", self.max_lateral_acceleration, low=0.0)
        check_flag("forward_only", self.forward_only)

    def __call__(self, command: Tensor) -> Tensor:
        """Return commands (speed, yaw rate), (..., 2), clipped."""
        speed, yaw_rate = command.unbind(-1)
        speed = speed.clamp(0.0 if self.forward_only else -self.max_speed, self.max_speed)
        yaw_rate = yaw_rate.clamp(-self.max_yaw_rate, self.max_yaw_rate)
        if self.max_lateral_acceleration is not None:
            yaw_rate = _within(yaw_rate, self._room(speed).clamp_min(self.least_yaw_rate))
            speed = _within(speed, self._room(yaw_rate))
        return torch.stack([speed, yaw_rate], -1)

    def _room(self, other: Tensor) -> Tensor:
        """Return the bound of speed or yaw rate that the lateral acceleration leaves, given the other one."""
        bound = torch.full_like(other, self.max_lateral_acceleration or 0.0)
        return torch.where(other == 0, math.inf, bound / other.abs())

    def save(self, folder: str | Path) -> Path:
        """Write the range to a run folder, whose policy is then clipped to it."""
        path = Path(folder) / COMMAND_RANGE_FILE
        write_json(path, dataclasses.asdict(self))
        return path

    @classmethod
    def load(cls, folder: str | Path) -> CommandRange | None:
        """Read the range of a run folder; None if it has none.

        Raises:
            InputError: if the file exists and is not a valid range.
        """
        path = Path(folder) / COMMAND_RANGE_FILE
        if not path.is_file():
            return None
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except (TypeError, ValueError) as error:  # an InputError is a ValueError
            raise InputError(f"{path} is no range of commands ({error}); remove it, or record it anew") from error


class CommandClippedPolicy(TensorDictModuleBase):
    """Policy whose commands are clipped to a range.

    The command is the last two entries of the observation, and of each row of the history. The input entries
    stay as they are; the outputs for the clipped ones are added.

    Args:
        policy: reads the observation, the history or both.
        limits: the range.
        keys: names of the entries.

    Example:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> policy = TensorDictModule(lambda observation: observation[:, -2:], ["observation"], ["action"])
        >>> clipped = CommandClippedPolicy(policy, CommandRange(max_speed=2.0, max_yaw_rate=1.0))
        >>> acted = clipped(TensorDict({"observation": torch.full((1, 5), 9.0)}, [1]))
        >>> acted["action"].tolist(), acted["observation"].max().item()
        ([[2.0, 1.0]], 9.0)
    """

    def __init__(self, policy: TensorDictModuleBase, limits: CommandRange, keys: NetworkKeys | None = None) -> None:
        super().__init__()
        self.policy, self.limits, self.keys = policy, limits, keys or NetworkKeys()
        self.in_keys, self.out_keys = list(policy.in_keys), list(policy.out_keys)

    def forward(self, tensordict: TensorDictBase, **kwargs: Any) -> TensorDictBase:
        """Add the policy's outputs for the clipped commands."""
        policy_input = tensordict.select(*self.in_keys, strict=False)
        for key in (self.keys.observation, self.keys.history):
            value = policy_input.get(key, None)
            if value is not None:
                policy_input.set(key, torch.cat([value[..., :-2], self.limits(value[..., -2:])], -1))
        return tensordict.update(self.policy(policy_input, **kwargs).select(*self.out_keys, strict=False))


def _within(value: Tensor, bound: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(value, -bound), bound)

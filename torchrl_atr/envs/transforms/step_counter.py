"""Time limit that grows during training, with randomised first episodes, so that robots do not all reset at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import StepCounter

from torchrl_atr._checks import check_number, check_whole
from torchrl_atr.envs.transforms.seeding import OwnGenerator, make_generator

_NEVER = torch.iinfo(torch.int64).max


class TimeLimitGrowth(NamedTuple):
    """Growth of a time limit over the steps of an env since its first reset, geometric from ``begin`` to ``end``.

    Attributes:
        first: limit until ``begin``, in steps.
        begin: step of the env from which the limit grows.
        end: step from which it is the final one.
        kept: share of the episodes, those after a full reset excepted, that keep the first limit.

    Example:
        >>> growth = TimeLimitGrowth(first=100, begin=1000, end=2000)
        >>> [growth.limit(step, 400) for step in (0, 1500, 2000)]
        [100, 200, 400]
    """

    first: int
    begin: int
    end: int
    kept: float = 0.0

    def limit(self, step: int, final: int) -> int:
        """Return the limit at a step of the env; ``final`` is the one in the end."""
        if step >= self.end:
            return final
        share = max(0.0, (step - self.begin) / (self.end - self.begin)) if self.end > self.begin else 0.0
        return round(self.first * (final / self.first) ** share)


class RandomizedStepCounter(OwnGenerator, StepCounter):
    """Step counter whose counts start anywhere below the time limit then, ``limit``, when all envs reset at once.

    Robots that start together and do not fall end together, in all later episodes: a batch then is
    the same short part of every episode. An env that resets later counts from zero. TorchRL's
    ``RandomTruncationTransform`` draws horizons from the global generator and compares once more at every step; this
    draws counts from its own.

    A reset of one env costs about as much as one of twenty. With ``check_interval`` they reset together: an episode
    that has lasted ``max_steps`` continues to the next multiple of ``check_interval`` steps of the env.

    Args:
        max_steps (int): Steps after which an episode is truncated.
        seed (int, optional): Of the counts; ``env.set_seed`` of a :class:`~torchrl_atr.envs.RidingEnv` sets it, too.
        check_interval (int): The limit is checked every so many steps, counted from the env's first reset. If
            ``max_steps`` is a multiple of it, only first episodes and those that began after a fall last longer.
            Defaults to 1.
        growth (TimeLimitGrowth, optional): A lower limit at first, for training that begins with short episodes.

    Raises:
        ValueError: ``check_interval`` is not positive, or the growth does not lead from a limit of 1 or more to
            ``max_steps``.

    Example:
        >>> from torchrl.envs import TransformedEnv
        >>> from torchrl.testing.mocking_classes import CountingEnv
        >>> env = TransformedEnv(CountingEnv(max_steps=100), RandomizedStepCounter(5, seed=0))
        >>> 1 <= env.rollout(50).shape[-1] <= 5
        True
    """

    max_steps: Any

    def __init__(
        self, max_steps: int, seed: int | None = None, check_interval: int = 1, growth: TimeLimitGrowth | None = None
    ) -> None:
        super().__init__(check_whole("max_steps", max_steps, low=1))
        check_interval = check_whole("check_interval", check_interval, None)
        if check_interval < 1:
            raise ValueError(f"check_interval must be at least 1, got {check_interval}")
        if growth is not None:
            check_whole("growth.first", growth.first, low=1, high=self.max_steps)
            check_whole("growth.end", growth.end, low=check_whole("growth.begin", growth.begin))
            check_number("growth.kept", growth.kept, 0.0, 1.0)
        self.check_interval, self.growth = check_interval, growth
        self._generator = make_generator(seed)
        self._steps = 0
        self._short: Tensor | None = None  # mask of the episodes that keep the first limit

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        tensordict_reset = super()._reset(tensordict, tensordict_reset)
        for reset_key, count_key in zip(self.reset_keys, self.step_count_keys, strict=True):
            if tensordict.get(reset_key, None) is None:
                count = tensordict_reset.get(count_key)
                drawn = torch.randint(self.limit, count.shape, generator=self._source())  # on the CPU, always
                tensordict_reset.set(count_key, drawn.to(count))
                self._short = None
            elif self.growth is not None and self.growth.kept:
                begun = tensordict.get(reset_key)
                drawn = torch.rand(begun.shape, generator=self._source()) < self.growth.kept
                short = torch.zeros_like(begun) if self._short is None else self._short
                self._short = torch.where(begun, drawn.to(begun.device), short)
        return tensordict_reset

    @property
    def limit(self) -> int:
        """Time limit now, in steps, of episodes that do not keep the first one."""
        return self.max_steps if self.growth is None else self.growth.limit(self._steps, self.max_steps)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._steps += 1
        final: int = self.max_steps
        now: int | Tensor = self.limit
        if self._steps % self.check_interval:
            now = _NEVER
        elif self._short is not None and self.growth is not None:
            now = torch.where(self._short, self.growth.first, now)
        self.max_steps = now  # StepCounter compares with a tensor, too
        try:
            return super()._step(tensordict, next_tensordict)
        finally:
            self.max_steps = final

    def get_extra_state(self) -> dict[str, Any]:
        """Return the env's steps since its first reset, and the generator's state."""
        short = {} if self._short is None else {"short": self._short.clone()}
        return {"steps": self._steps, "generator": self._generator.get_state(), **short}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`."""
        self._steps, self._short = state["steps"], state.get("short")
        self._restore_generator(state["generator"])

"""A time limit that robots which never fall do not all reach at once."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.envs.transforms import StepCounter

from torchrl_atr.envs.transforms.seeding import make_generator


class StaggeredCounter(StepCounter):
    """A :class:`~torchrl.envs.StepCounter` whose counts start anywhere below ``max_steps`` when all envs begin at once.

    Robots that start together and do not fall end together, in every episode to come: a batch then is
    the same short part of everybody's episode. An env that begins anew later counts from zero. TorchRL's
    ``RandomTruncationTransform`` draws horizons, at every step of which it compares once more; this draws counts.

    Args:
        max_steps (int): Steps after which an episode is truncated.
        seed (int, optional): Of the counts.

    Example:
        >>> from torchrl.envs import TransformedEnv
        >>> from torchrl.testing.mocking_classes import CountingEnv
        >>> env = TransformedEnv(CountingEnv(max_steps=100), StaggeredCounter(5, seed=0))
        >>> 1 <= env.rollout(50).shape[-1] <= 5
        True
    """

    def __init__(self, max_steps: int, seed: int | None = None) -> None:
        super().__init__(max_steps)
        self._generator = make_generator(seed)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        tensordict_reset = super()._reset(tensordict, tensordict_reset)
        for reset_key, count_key in zip(self.reset_keys, self.step_count_keys, strict=True):
            if tensordict.get(reset_key, None) is None:
                count = tensordict_reset.get(count_key)
                drawn = torch.randint(self.max_steps, count.shape, generator=self._generator)  # on the CPU, as anywhere
                tensordict_reset.set(count_key, drawn.to(count))
        return tensordict_reset

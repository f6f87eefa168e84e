"""Transform that ends the episodes of transporters that are faster than any command, for training."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.transforms import TerminateTransform, Transform

from torchrl_atr._checks import check_key, check_keys, check_kind, check_number, check_pair
from torchrl_atr.envs.transforms.curriculum import CommandCurriculum
from torchrl_atr.envs.transforms.done_keys import flag_key


class OverspeedTermination(TerminateTransform):
    """Transform that terminates rows whose transporter is faster than any command of the curriculum plus a margin.

    The tracking rewards exp(-|e| / 0.5) have no slope at an error of some metres per second, which an untrained robot
    reaches within a second: such states give no learning signal. Ending such episodes keeps rollouts where rewards
    have a slope; the limit grows with the curriculum. It is for training, not part of the task: evaluation does not
    use it.

    TorchRL's :class:`~torchrl.envs.transforms.TerminateTransform` ends the episodes but adds no penalty: the env
    computed the reward before it knew that the episode ends, so the penalty is added here.

    Args:
        curriculum: whose frontier bounds the commands.
        margin: added to the largest ``|c_v|``, m/s, and ``|c_ω|``, rad/s.
        penalty: reward of an early termination (r17); added to each of ``reward_keys``.
        speeds_key: forward speed and yaw rate, ``(*B, 2)``.
        reward_keys: the reward and its term, ``(*B, 1)``.

    Raises:
        ValueError: if a margin is not positive.

    Example:
        >>> OverspeedTermination(CommandCurriculum((0.2, 0.2), seed=0)).margin
        (2.0, 2.0)
    """

    def __init__(
        self,
        curriculum: CommandCurriculum,
        margin: tuple[float, float] = (2.0, 2.0),
        penalty: float = 0.0,
        speeds_key: NestedKey = "speeds",
        reward_keys: Sequence[NestedKey] = ("reward", ("reward_terms", "termination")),
    ) -> None:
        super().__init__(self.too_fast)
        self.speeds_key = check_key("speeds_key", speeds_key)
        check_kind("curriculum", curriculum, CommandCurriculum, "the CommandCurriculum in front of it")
        self.margin = check_pair("margin", margin, "two positive numbers (m/s, rad/s)")
        self.penalty = check_number("penalty", penalty)
        self.reward_keys = tuple(check_keys("reward_keys", reward_keys))
        self._curriculum = [curriculum]  # in a list: a part of the stack, not a submodule of this transform

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to a stack or an env; in the clone of a stack the curriculum is that of the clone."""
        super().set_container(container)
        found = [part for part in getattr(container, "transforms", ()) if isinstance(part, CommandCurriculum)]
        if found and all(part is not self._curriculum[0] for part in found):
            self._curriculum = found[-1:]
        self.stop = self.too_fast  # of this transform, where it is a copy

    def too_fast(self, next_tensordict: TensorDictBase) -> Tensor:
        """Return the rows beyond the frontier and the margin, bool ``(*B, 1)``."""
        speeds = next_tensordict.get(self.speeds_key)
        reach = zip(self._curriculum[0].frontier, self.margin, strict=True)
        limit = speeds.new_tensor([largest + margin for largest, margin in reach])
        return (speeds.abs() > limit).any(-1, keepdim=True)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        terminated = flag_key(self, "terminated")
        before = next_tensordict.get(terminated)
        next_tensordict = super()._step(tensordict, next_tensordict)
        ended = next_tensordict.get(terminated) & ~before
        for key in self.reward_keys if self.penalty else ():
            reward = next_tensordict.get(key)
            next_tensordict.set(key, reward + self.penalty * ended.to(reward.dtype))
        return next_tensordict

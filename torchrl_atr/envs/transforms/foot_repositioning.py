"""Transform that carries out scripted steps beside the policy's action."""

from __future__ import annotations

from typing import NoReturn, Protocol

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import Transform

from torchrl_atr._checks import check_key


class ScriptedSteps(Protocol):
    """Change of a policy's action, such as :class:`~torchrl_atr.envs.tasks.riding.foot_steps.FootSteps`."""

    def start(self, robots: int) -> Tensor:
        """Return the state at the start of an episode, (N, S)."""
        ...

    def __call__(self, action: Tensor, proprio: Tensor, extrinsic: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the action that is carried out, and the state after it."""
        ...


class FootRepositioning(Transform):
    """Transform that changes actions by scripted steps, before the env's step.

    The collected action, whose probability a policy knows, stays what the policy gave; the env below, whose
    observations hold the last action, sees the one that is carried out. The transform has no state of its own: the
    steps' is an entry of the TensorDict. Without the extrinsic entry, as of a random policy, actions stay as they are.

    Args:
        steps: what changes the actions.
        state_key: the state, ``(*B, S)``.
        action_key: the action, ``(*B, 12)``.
        proprio_key: what the robot senses.
        extrinsic_key: x_ext that the policy acts on, which it writes.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> env = make_riding_env(num_envs=2, seed=0, reposition_feet=0.16)
        >>> env.reset()["foot_steps"].shape
        torch.Size([2, 34])
    """

    def __init__(
        self,
        steps: ScriptedSteps,
        *,
        state_key: NestedKey = "foot_steps",
        action_key: NestedKey = "action",
        proprio_key: NestedKey = "proprio",
        extrinsic_key: NestedKey = ("act", "extrinsic"),
    ) -> None:
        super().__init__(in_keys=[], out_keys=[check_key("state_key", state_key)])
        self.steps, self.state_key = steps, state_key
        self.action_key, self.proprio_key = check_key("action_key", action_key), check_key("proprio_key", proprio_key)
        self.extrinsic_key = check_key("extrinsic_key", extrinsic_key)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        names = (self.action_key, self.proprio_key, self.extrinsic_key, self.state_key)
        read = [tensordict.get(name, None) for name in names]
        if any(value is None for value in read):
            return tensordict
        shape = read[-1].shape[:-1]
        action, state = self.steps(*(value.detach().reshape(-1, value.shape[-1]) for value in read))
        tensordict.set(self.action_key, action.reshape(*shape, -1))
        return tensordict.set(self.state_key, state.reshape(*shape, -1))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        shape = tensordict_reset.batch_size
        return tensordict_reset.set(self.state_key, self.steps.start(shape.numel()).reshape(*shape, -1))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.state_key, tensordict.get(self.state_key))

    def _call(self, next_tensordict: TensorDictBase) -> NoReturn:
        raise NotImplementedError(
            "FootRepositioning only works on the reset and step of an environment: TransformedEnv(env, Compose(..., "
            "FootRepositioning(...))). Remove it from the module or replay buffer."
        )

    forward = _call

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the state."""
        shape = (*observation_spec.shape, self.steps.start(1).shape[-1])
        observation_spec[self.state_key] = Unbounded(shape, device=observation_spec.device)
        return observation_spec

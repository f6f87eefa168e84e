"""Transform for the observation history o_{t-H} ... o_{t-1} that the estimators read."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NoReturn

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs.transforms import Transform

from torchrl_atr._checks import check_flag, check_key, check_whole
from torchrl_atr._inference import keeps_normal_tensors
from torchrl_atr.envs.transforms.done_keys import flag_key


class ObservationHistory(Transform):
    """Transform that writes the ``length`` observations before the current one, oldest first, of this episode only.

    ``history[..., 0, :]`` is o_{t-H} and ``history[..., -1, :]`` is o_{t-1} (question A19); before the episode
    has H steps the front is filled with o_0, so at t = 0 it is H copies of it. Place it behind all transforms
    that rewrite the observation: it stores its input, with the command that was in force.

    TorchRL's ``UnsqueezeTransform -> CatFrames(H + 1, padding="same")`` comes close, but needs a custom
    transform to cut the newest frame, and its uninitialised buffer makes ``env.state_dict()`` fail before the
    first reset and ``env.load_state_dict()`` fail on a fresh environment.

    Args:
        length: H, the number of past observations.
        in_key: The observation, ``(*B, D)``.
        out_key: The history, ``(*B, H, D)``, of the observation's dtype.
        include_current: Whether the history is o_{t-H+1} ... o_t instead (the other answer to A19).

    Raises:
        ValueError: ``length`` is not positive.

    Example:
        >>> ObservationHistory(10).length
        10
    """

    _frames: Tensor | None

    def __init__(
        self,
        length: int,
        in_key: NestedKey = "observation",
        out_key: NestedKey = "history",
        include_current: bool = False,
    ) -> None:
        length = check_whole("length", length, None)
        check_flag("include_current", include_current)
        for name, key in {"in_key": in_key, "out_key": out_key}.items():
            check_key(name, key)
        if length < 1:
            raise ValueError(f"length must be at least 1, got {length}")
        super().__init__(in_keys=[in_key], out_keys=[out_key])
        self.length = length
        self.include_current = include_current
        self.register_buffer("_frames", None, persistent=False)  # o_{t-H} ... o_t, (*B, H + 1, D); None before a reset

    @keeps_normal_tensors
    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        first = self._observation(tensordict_reset)
        before, mask = self._frames, tensordict.get(flag_key(self, "_reset"), None)
        frames = first.expand(*first.shape[:-2], self.length + 1, first.shape[-1])
        if mask is not None and before is not None and before.shape == frames.shape:
            frames = torch.where(mask.reshape(*first.shape[:-2], 1, 1), frames, before)
        self._frames = frames
        return self._emit(tensordict_reset)

    @keeps_normal_tensors
    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if self._frames is None:
            raise RuntimeError("ObservationHistory has no history before the first reset; call env.reset() first")
        self._frames = torch.cat([self._frames[..., 1:, :], self._observation(next_tensordict)], -2)
        return self._emit(next_tensordict)

    def _call(self, next_tensordict: TensorDictBase) -> NoReturn:
        raise NotImplementedError(
            "ObservationHistory only works on the reset and step of an environment: TransformedEnv(env, "
            "ObservationHistory(...)). Collected data hold its output: remove it from the module or buffer."
        )

    forward = _call

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the history: the observation's spec, ``length`` times.

        Raises:
            KeyError: The environment emits no such observation.
        """
        if self.in_keys[0] not in observation_spec.keys(True, True):
            raise KeyError(self._absent(observation_spec.keys(True, True)))
        frame = observation_spec[self.in_keys[0]]
        shape = (*frame.shape[:-1], self.length, frame.shape[-1])
        observation_spec[self.out_keys[0]] = frame.unsqueeze(-2).expand(shape)
        return observation_spec

    @keeps_normal_tensors
    def clone(self) -> ObservationHistory:
        """Return a copy without parent, with its own frames."""
        other = super().clone()
        other.set_extra_state(self.get_extra_state())
        return other

    def get_extra_state(self) -> dict[str, Any]:
        """Return the frames, ``(*B, H + 1, D)``, or None before the first reset."""
        return {"frames": None if self._frames is None else self._frames.clone()}

    @keeps_normal_tensors
    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`; frames of another shape are dropped at the next reset."""
        frames, device = state["frames"], self.parent.device if self.parent is not None else None
        self._frames = None if frames is None else frames.to(device or frames.device, copy=True)

    def _observation(self, tensordict: TensorDictBase) -> Tensor:
        observation = tensordict.get(self.in_keys[0], None)
        if observation is None:
            raise KeyError(self._absent(tensordict.keys(True, True)))
        return observation.unsqueeze(-2)

    def _absent(self, keys: Iterable[NestedKey]) -> str:
        known = [key for key in keys if isinstance(key, str)]
        return f"observation {self.in_keys[0]!r} is not among the env's entries {known}; name one of these as in_key"

    def _emit(self, tensordict: TensorDictBase) -> TensorDictBase:
        assert self._frames is not None
        shown = self._frames[..., 1:, :] if self.include_current else self._frames[..., :-1, :]
        return tensordict.set(self.out_keys[0], shown.clone())  # a copy: theirs to change, also in place

"""What a collector needs to store once, not at the root and in ``next``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite, TensorSpec

from torchrl_atr._checks import check_keys
from torchrl_atr._registry import nearest_entry
from torchrl_atr._torchrl_private import AfterStepTransform


class CompactStorage(AfterStepTransform):
    """Keeps entries out of ``next``, or out of the root, of what :class:`~torchrl.collectors.Collector` stores.

    TorchRL stores every observation twice. The history at the root of a step is all that policies and estimators read
    of it, and makes up most of a step; what says how a step went, such as reward terms, is of no use at the root of the
    next one, to which it would be carried, and merged with every reset.

    TorchRL's ``ExcludeTransform`` takes an entry out of the root as well, from which policies read it; its collectors'
    ``compact_obs=True`` leaves out all observations of ``next``, NaN where an episode ends, so that truncated episodes
    lose their last value.

    Place it last. It is for collectors, and for rollouts that stop when an env is done: others keep all of their last
    step. What is stored in ``next`` is no root to go on from, and TorchRL's ``check_env_specs`` insists on all that is
    observed being there. Loss modules that read histories of ``next`` need them, too.
    :class:`~torchrl.envs.ParallelEnv` knows only of what is observed: put this around it, not into its workers.

    Args:
        at_root: observations that ``next`` does without once they were carried to the next root.
        in_next: entries of a step that are no observations from here on: neither resets nor roots hold them, and no
            transform may read them there.

    Example:
        >>> from torchrl.envs import TransformedEnv
        >>> from torchrl.testing.mocking_classes import CountingEnv
        >>> env = TransformedEnv(CountingEnv(), CompactStorage(at_root=["observation"]))
        >>> data = env.rollout(2)
        >>> "observation" in data, "observation" in data["next"]
        (True, False)
    """

    worker_error = "wrap it instead: TransformedEnv(ParallelEnv(...), CompactStorage(...))"

    def __init__(self, at_root: Sequence[NestedKey] = (), in_next: Sequence[NestedKey] = ()) -> None:
        for name, keys in {"at_root": at_root, "in_next": in_next}.items():
            check_keys(name, keys, f'a list of keys, such as ["{keys}"]')
        super().__init__()
        self.at_root, self.in_next = tuple(at_root), tuple(in_next)
        self._specs: dict[NestedKey, TensorSpec] = {}

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """What is in ``next`` alone is not observed.

        Raises:
            KeyError: The environment emits no such entry.
        """
        for key in (*self.at_root, *self.in_next):
            if key not in observation_spec.keys(True):
                raise KeyError(f"the env has no entry {key!r}; {nearest_entry(key, observation_spec)}")
        self._specs = {key: observation_spec[key] for key in self.in_next}
        for key in self.in_next:
            del observation_spec[key]
        return observation_spec

    def transform_fake_tensordict(self, fake_tensordict: TensorDictBase) -> TensorDictBase:
        """What a step holds, from which collectors make their buffers."""
        after = fake_tensordict.get("next")
        for key, spec in self._specs.items():
            after.set(key, spec.zero())
        fake_tensordict.set("next", after.exclude(*self.at_root))
        return fake_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return tensordict_reset.exclude(*self.in_next)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def after_step(self, step: TensorDictBase, root: TensorDictBase) -> None:
        """Remove each entry where it is not kept."""
        after = step.get("next")
        for key in self.at_root:
            after.pop(key, None)
        for key in self.in_next:
            root.pop(key, None)  # of a root that was not reset here

    def _call(self, next_tensordict: TensorDictBase) -> NoReturn:
        raise NotImplementedError("CompactStorage only works on the steps of an environment")

    forward = _call

"""Transform that lets a collector store entries once, not both at the root and in ``next``."""

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
    """Transform that drops entries from ``next``, or from the root, of steps that a collector stores.

    TorchRL's :class:`~torchrl.collectors.Collector` stores every observation twice. Policies and estimators read the
    history at the root alone, and it is most of a step's memory; diagnostics of a step, such as reward terms, are not
    needed at the root of the next one, to which they would be carried, and merged with every reset.

    TorchRL's ``ExcludeTransform`` takes an entry out of the root as well, from which policies read it; its collectors'
    ``compact_obs=True`` leaves out all observations of ``next``, NaN where an episode ends, so that truncated episodes
    lose their last value.

    Place it last. It is for collectors, and for rollouts that stop when an env is done: others keep all of their last
    step. A stored ``next`` is not a complete root to continue from, and TorchRL's ``check_env_specs`` requires all
    observations in it. Loss modules that read histories of ``next`` need them, too.
    :class:`~torchrl.envs.ParallelEnv` transfers observations only: wrap it, do not use this in its workers.

    Args:
        at_root: observations that are dropped from ``next`` once they were carried to the next root.
        in_next: entries of a step that are not observations from here on: neither resets nor roots hold them, and no
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
        """Remove the entries of ``in_next`` from the observation spec.

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
        """Remove the entries that are not stored, so that collectors allocate no buffers for them."""
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
        """Remove each entry from where it is not kept."""
        after = step.get("next")
        for key in self.at_root:
            after.pop(key, None)
        for key in self.in_next:
            root.pop(key, None)  # present at a root that was not reset by this env

    def _call(self, next_tensordict: TensorDictBase) -> NoReturn:
        raise NotImplementedError("CompactStorage only works on the steps of an environment")

    forward = _call

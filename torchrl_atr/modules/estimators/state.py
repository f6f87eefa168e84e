"""Hidden states of modules: which module has one, and the env's part in carrying it."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey, unravel_key, unravel_key_list
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv
from torchrl.envs.transforms import Transform
from torchrl.modules.utils import get_primers_from_module

from torchrl_atr._errors import InputError

IS_INIT = "is_init"
"""Entry that tells where an episode begins: ``InitTracker`` writes it, TorchRL's recurrent modules read it."""


def state_keys(module: TensorDictModuleBase) -> list[NestedKey]:
    """Return the keys of the hidden states that a module reads and writes for the next step; empty without any.

    Example:
        >>> from torchrl.modules import GRUModule
        >>> state_keys(GRUModule(3, 8, in_keys=["x", "h"], out_keys=["y", ("next", "h")]))
        ['h']
    """
    written = [key for key in unravel_key_list(list(module.out_keys)) if isinstance(key, tuple) and key[0] == "next"]
    return [key[1] if len(key) == 2 else key[1:] for key in written]


def with_state(env: EnvBase, module: TensorDictModuleBase) -> EnvBase:
    """Return the env with TorchRL's transforms that carry a policy's hidden state from step to step, where it has one.

    ``InitTracker`` marks where episodes begin, a ``TensorDictPrimer`` sets the state to zero there. They are appended
    in place where there are transforms already; an env that has them, or a policy without a state, changes nothing.

    Args:
        env (EnvBase): for rollouts of the policy.
        module (TensorDictModuleBase): the policy, or an estimator.

    Raises:
        InputError: if the env carries a state of another size.

    Example:
        >>> from torchrl.modules import GRUModule
        >>> from torchrl.testing.mocking_classes import ContinuousActionVecMockEnv
        >>> memory = GRUModule(7, 8, in_keys=["observation", "h"], out_keys=["y", ("next", "h")])
        >>> env = with_state(ContinuousActionVecMockEnv(), memory)
        >>> env.reset()["h"].shape
        torch.Size([1, 8])
    """
    keys = state_keys(module)
    if not keys:
        return env
    primer, spec = get_primers_from_module(module, warn=False), env.full_observation_spec
    wanted = _shapes(primer)
    missing = [key for key in keys if key not in wanted]
    if missing:
        raise InputError(
            f"a policy writes the state {('next', missing[0])!r}, for which no module of it has a primer; give the "
            "module that keeps the state a method make_tensordict_primer, as torchrl.modules.GRUModule has"
        )
    known = [key for key in keys if key in spec.keys(True, True)]
    for key in known:
        if spec[key].shape[len(env.batch_size) :] != wanted[key]:
            raise InputError(f"the env carries a state {key!r} of another size than this policy's; make a new env")
    new = [part for part in _parts(primer) if not set(_shapes(part)) <= set(known)]
    if not new:
        return env
    env = env if isinstance(env, TransformedEnv) else TransformedEnv(env)
    if IS_INIT not in spec.keys(True, True):
        env.append_transform(InitTracker())
    for part in new:
        env.append_transform(part)
    return env


def state_shapes(module: TensorDictModuleBase) -> dict[NestedKey, torch.Size]:
    """Return the shape of each hidden state that a module's parts keep, without batch dimensions, by key.

    Example:
        >>> from torchrl.modules import GRUModule
        >>> state_shapes(GRUModule(3, 8, in_keys=["x", "h"], out_keys=["y", ("next", "h")]))
        {'h': torch.Size([1, 8])}
    """
    return _shapes(get_primers_from_module(module, warn=False))


def _shapes(primer: Transform | None) -> dict[NestedKey, torch.Size]:
    return {unravel_key(key): spec.shape for part in _parts(primer) for key, spec in part.primers.items(True, True)}


def _parts(primer: Transform | None) -> list[Any]:
    return list(primer) if isinstance(primer, Compose) else [] if primer is None else [primer]

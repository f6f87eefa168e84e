"""What evaluation needs of an env besides TorchRL's interface: pinned commands, true speeds, state names."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase, TransformedEnv
from torchrl.envs.transforms import Transform
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchrl_atr.envs.task.observations import EXTRINSIC, extrinsic_components
from torchrl_atr.envs.task.state import StateReader


def base_env(env: EnvBase) -> Any:
    """The env below all transforms."""
    while isinstance(env, TransformedEnv):
        env = env.base_env
    return env


@contextmanager
def deterministic(policy: TensorDictModuleBase) -> Iterator[None]:
    """Run a block in eval mode, without gradients and exploration; afterwards each module is in the mode it was in.

    Args:
        policy: its modules may be shared, in one mode or several.

    Example:
        >>> from tensordict.nn import TensorDictModule
        >>> policy = TensorDictModule(torch.nn.Dropout(), ["observation"], ["action"])
        >>> with deterministic(policy):
        ...     policy.module.training
        False
        >>> policy.module.training
        True
    """
    modes = {module: module.training for module in policy.modules()}
    policy.eval()
    try:
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            yield
    finally:
        for module, mode in modes.items():
            module.training = mode


def command_owner(env: EnvBase) -> Any:
    """The transform that can pin commands (:class:`~torchrl_atr.envs.transforms.CommandCurriculum`).

    Raises:
        TypeError: if no transform of ``env`` has a method ``pin``.
    """
    for transform in _transforms(env):
        if callable(getattr(transform, "pin", None)):
            return transform
    raise TypeError(
        "no transform of this env can pin commands; build it with make_riding_env, or add CommandCurriculum "
        "(or a transform of your own with pin(command) and unpin()) to it"
    )


def _transforms(env: EnvBase) -> Iterator[Transform]:
    while isinstance(env, TransformedEnv):
        yield from env.transform if isinstance(env.transform, Compose) else [env.transform]
        env = env.base_env


def platform_speeds(env: EnvBase) -> Tensor:
    """Forward speed (m/s) and yaw rate (rad/s) of each robot's platform now, (N, 2) float32.

    Raises:
        TypeError: if the env is not a RidingEnv below its transforms.
    """
    engine = getattr(base_env(env), "engine", None)
    if engine is None:
        raise TypeError(
            f"{type(base_env(env)).__name__} has no physics engine to read speeds from; pass speeds=, a "
            "function of the env that returns (N, 2): forward speed in m/s and yaw rate in rad/s"
        )
    return torch.tensor(engine.speeds, dtype=torch.float32)


def extrinsic_names(env: EnvBase, size: int) -> tuple[str, ...]:
    """Names of the ``size`` extrinsic states, in order: ``contacts[0]``, ... (numbers for envs not ours)."""
    engine = getattr(base_env(env), "engine", None)
    if engine is not None:
        state = StateReader(engine).read()
        components = extrinsic_components(engine.law.readings)
        widths = {name: EXTRINSIC[name](state).shape[-1] for name in components}
        names = tuple(f"{name}[{i}]" for name, width in widths.items() for i in range(width))
        if len(names) == size:
            return names
    return tuple(f"extrinsic[{i}]" for i in range(size))

"""Access to an env beyond TorchRL's interface: pinned commands, achieved speeds, names of states."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.access import base_env, transforms_of


@contextmanager
def deterministic(policy: TensorDictModuleBase) -> Iterator[None]:
    """Run a block in eval mode, without gradients and exploration; restore each module's mode afterwards.

    Args:
        policy: modules may be shared and in different modes.

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
    """Return the transform that can pin commands (:class:`~torchrl_atr.envs.transforms.CommandCurriculum`).

    Raises:
        TypeError: if no transform of ``env`` has a method ``pin``.
    """
    for transform in transforms_of(env):
        if callable(getattr(transform, "pin", None)):
            return transform
    raise TypeError(
        "no transform of this env can pin commands; build it with make_riding_env, or add CommandCurriculum "
        "(or your own transform with pin(command) and unpin()) to it"
    )


def command_limits(env: EnvBase, largest: tuple[float, float] = (2.0, 1.0)) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the lowest and the highest command, (2,) each, within ``largest`` and the env's command grid.

    Example:
        >>> from torchrl_atr.envs import make_env
        >>> from torchrl_atr.envs.tasks import walking
        >>> low, high = command_limits(make_env(walking(), num_envs=1))
        >>> low.tolist(), high.tolist()
        ([0.0, -1.0], [1.5, 1.0])
    """
    grid = getattr(command_owner(env), "grid", None)
    high = np.array(largest) if grid is None else np.minimum(largest, grid.bounds)
    backwards = 1.0 if grid is None or not grid.forward_only else 0.0
    return 0.0 - high * (backwards, 1.0), high


def achieved_speeds(env: EnvBase) -> Tensor:
    """Return the achieved value of each command component, such as forward speed and yaw rate, (N, C) float32.

    Raises:
        TypeError: if the env below all transforms is not a QuadrupedEnv whose task observes ``speeds``.
    """
    base = base_env(env)
    speeds = base.speeds if isinstance(base, QuadrupedEnv) else None
    if speeds is None:
        raise TypeError(
            f"{type(base).__name__} does not report what the robots achieve of the command; pass speeds=, a "
            "function of the env that returns (N, 2): forward speed in m/s and yaw rate in rad/s"
        )
    return speeds


def ended_by(env: EnvBase) -> dict[str, Tensor]:
    """Return by cause the robots whose episode it ended in the last step, (N,) bool; empty for other base envs."""
    base = base_env(env)
    return dict(zip(base.runner.terms.causes, base.runner.causes)) if isinstance(base, QuadrupedEnv) else {}


def disturbance_steps(env: EnvBase) -> dict[str, int]:
    """Return by name the control steps between two disturbances in force, those of episodes that begin next.

    Empty for other base envs.

    Example:
        >>> from torchrl_atr.envs import RidingEnv
        >>> disturbance_steps(RidingEnv(num_envs=1))
        {'push': 150}
    """
    base = base_env(env)
    known = base.runner.disturbances if isinstance(base, QuadrupedEnv) else {}
    return {name: disturbance.steps for name, disturbance in known.items()}


def intrinsic_names(env: EnvBase, size: int) -> tuple[str, ...]:
    """Return the names of the ``size`` components of the intrinsic parameters, in order; numbered for other base envs.

    Example:
        >>> from torchrl_atr.envs import RidingEnv
        >>> intrinsic_names(RidingEnv(num_envs=1), 34)[:2]
        ('payload', 'com_shift[0]')
    """
    base = base_env(env)
    if isinstance(base, QuadrupedEnv) and base.runner.intrinsics.size == size:
        names: list[str] = []
        for name, part in base.runner.intrinsics.slices.items():
            count = part.stop - part.start
            names += [name] if count == 1 else [f"{name}[{i}]" for i in range(count)]
        return tuple(names)
    return tuple(f"intrinsic[{i}]" for i in range(size))


class Component(NamedTuple):
    """Component of the extrinsic state.

    Attributes:
        name: such as ``body_velocity[0]``.
        label: text for tables, such as ``body velocity x``.
        unit: of the component; None where it is not known.
    """

    name: str
    label: str
    unit: str | None


def extrinsic_components(env: EnvBase, size: int) -> tuple[Component, ...]:
    """Return the ``size`` components of the extrinsic state, in order; numbered for other base envs."""
    key, base = ("privileged", "extrinsic"), base_env(env)
    if isinstance(base, QuadrupedEnv) and key in base.task.observations:
        observations = base.runner.terms.observations
        pairs = zip(observations.names(key), observations.labels(key))
        components = tuple(Component(name, label, unit or None) for name, (label, unit) in pairs)
        if len(components) == size:
            return components
    names = [f"extrinsic[{i}]" for i in range(size)]
    return tuple(Component(name, name, None) for name in names)

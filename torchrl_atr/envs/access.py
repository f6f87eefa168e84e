"""Access to the env below all transforms, and to the transforms around it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from torchrl.envs import Compose, EnvBase, TransformedEnv
from torchrl.envs.transforms import Transform


def base_env(env: EnvBase) -> Any:
    """Return the env below all transforms.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> type(base_env(make_riding_env(num_envs=1))).__name__
        'QuadrupedEnv'
    """
    while isinstance(env, TransformedEnv):
        env = env.base_env
    return env


def transforms_of(env: EnvBase) -> Iterator[Transform]:
    """Yield the transforms around an env, those of the outermost stack first; none of an env without any.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> [type(part).__name__ for part in transforms_of(make_riding_env(num_envs=1))][:3]
        ['CommandCurriculum', 'CatTensors', 'ObservationHistory']
    """
    while isinstance(env, TransformedEnv):
        yield from env.transform if isinstance(env.transform, Compose) else [env.transform]
        env = env.base_env

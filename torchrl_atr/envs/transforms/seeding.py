"""Random generator of a transform, which follows the seeds of its env."""

from __future__ import annotations

from typing import Any

import torch
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.transforms import Transform

from torchrl_atr._checks import check_whole
from torchrl_atr._torchrl_private import env_around, parallel_seeds, serial_envs

_UNKNOWN = ("not attached yet",)


def make_generator(seed: int | None) -> torch.Generator:
    """Return a generator on the CPU; without a seed from the operating system, so that forked workers draw differently.

    Raises:
        InputError: for a seed that is not a whole number.

    Example:
        >>> make_generator(3).initial_seed()
        3
    """
    seed = check_whole("seed", seed, high=2**63 - 1, optional=True)
    generator = torch.Generator()
    if seed is None:
        generator.seed()
    else:
        generator.manual_seed(seed)
    return generator


def env_seeding(env: EnvBase | None) -> tuple[Any, ...] | None:
    """Return a value that changes whenever an env is seeded, its seed last; None if it was not, or is unknown.

    TorchRL passes ``env.set_seed(...)`` to the base env, not to its transforms. A base env exposes it as its attribute
    ``seeding``, ``(how many times, seed)``, as :class:`~torchrl_atr.envs.RidingEnv` does.
    """
    while isinstance(env, TransformedEnv):
        env = env.base_env
    if isinstance(env, ParallelEnv):
        seeds = parallel_seeds(env)
        return (id(seeds), seeds, seeds[0]) if seeds else None
    if isinstance(env, SerialEnv):
        seedings = [env_seeding(part) for part in serial_envs(env)]
        return (*seedings, seedings[0][-1]) if seedings and seedings[0] is not None else None
    return None if env is None else vars(env).get("seeding")


class OwnGenerator(Transform):
    """Transform with its own generator, seeded by its constructor, :meth:`set_seed` or ``env.set_seed``.

    TorchRL's random transforms draw from torch's global generator: their draws depend on all other draws. A subclass
    draws from the generator that :meth:`_source` returns.
    """

    _generator: torch.Generator
    _seen: tuple[Any, ...] | None = _UNKNOWN

    def set_seed(self, seed: int) -> None:
        """Restart this transform's own generator.

        Raises:
            InputError: for a seed that is not a whole number.
        """
        self._generator.manual_seed(check_whole("seed", seed, high=2**63 - 1))
        self._seen = env_seeding(env_around(self))

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to an env; its earlier seeds do not count."""
        super().set_container(container)
        env = env_around(self)
        if self._seen is _UNKNOWN and env is not None:
            self._seen = env_seeding(env)

    def clone(self) -> OwnGenerator:
        """Return a copy without parent, with a generator of its own in the same state."""
        other = super().clone()
        other._generator = torch.Generator()
        other._generator.set_state(self._generator.get_state())
        return other

    def _source(self) -> torch.Generator:
        """Return the generator, restarted if the env was seeded since it was last used."""
        now = env_seeding(env_around(self))
        if now != self._seen:
            self._seen = now
            if now is not None:
                self._generator.manual_seed(now[-1])
        return self._generator

    def _restore_generator(self, state: torch.Tensor) -> None:
        self._generator.set_state(state.cpu())
        self._seen = env_seeding(env_around(self))

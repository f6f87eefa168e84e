"""Keys of an env's flags: where ``done`` is nested, ``_reset`` and ``terminated`` are beside it."""

from __future__ import annotations

from tensordict.utils import NestedKey
from torchrl.envs.transforms import Transform

from torchrl_atr._errors import InputError


def flag_key(transform: Transform, name: str) -> NestedKey:
    """Return the key of a flag, such as ``"_reset"`` or ``"terminated"``, beside the ``done`` of a transform's env.

    Raises:
        InputError: if parts of the env end at different times, each with a flag of its own.

    Example:
        >>> from torchrl.envs import TransformedEnv
        >>> from torchrl.testing.mocking_classes import NestedCountingEnv
        >>> env = TransformedEnv(NestedCountingEnv(nest_done=True, nested_dim=1), Transform())
        >>> flag_key(env.transform, "_reset")
        ('data', '_reset')
    """
    parent = transform.parent
    keys = ["_reset"] if parent is None else parent.reset_keys
    if len(keys) != 1:
        raise InputError(
            f"{type(transform).__name__} needs an env whose episodes end as a whole; this one is reset in parts, by "
            f"{keys}; give it one done flag of its batch size"
        )
    key = keys[0]
    return name if isinstance(key, str) else (*key[:-1], name)

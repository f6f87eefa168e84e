"""Specification of an estimator: its role, sizes and the keys that it reads and writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from tensordict import NestedKey

from torchrl_atr._checks import check_choice, check_kind
from torchrl_atr.modules.keys import NetworkKeys

Role = Literal["intrinsic", "extrinsic", "both"]
"""Role of an estimator: the latent of hidden parameters, hidden states, or both."""
ROLES: tuple[str, ...] = get_args(Role)
"""All of :data:`Role`."""


@dataclass(frozen=True)
class EstimatorSpec:
    """Role and sizes of an estimator, and the keys of its entries.

    A factory that has a parameter ``spec`` is given one of these and returns a TensorDict module; all that the module
    reads and writes is normalised.

    Attributes:
        role: ``intrinsic`` for the latent, ``extrinsic`` for the extrinsic state, ``both`` for one estimator of both.
        history_shape: (H, D): H observations of D components.
        targets: size of each estimate, by ``intrinsic`` and ``extrinsic``; in this order for ``both``.
        inputs: size of each further input, by key.
        keys: names of all entries.

    Raises:
        InputError: for an unknown role. ValueError: for targets that are not the role's.

    Example:
        >>> spec = EstimatorSpec("extrinsic", (10, 46), {"extrinsic": 16}, {"wind": 2})
        >>> spec.window_shape, spec.out_features, spec.estimate_keys
        ((10, 48), 16, [('estimate', 'extrinsic')])
    """

    role: Role
    history_shape: tuple[int, int]
    targets: Mapping[str, int]
    inputs: Mapping[NestedKey, int] = field(default_factory=dict)
    keys: NetworkKeys = field(default_factory=NetworkKeys)

    def __post_init__(self) -> None:
        check_choice("role", self.role, ROLES)
        check_kind("keys", self.keys, NetworkKeys, "NetworkKeys(...)")
        wanted = ["intrinsic", "extrinsic"] if self.role == "both" else [self.role]
        if list(self.targets) != wanted:
            raise ValueError(f"targets={dict(self.targets)}: the role {self.role!r} estimates {' and '.join(wanted)}")

    @property
    def window_shape(self) -> tuple[int, int]:
        """Shape of the history with the further inputs beside each of its observations, (H, D + S)."""
        return self.history_shape[0], self.history_shape[1] + sum(self.inputs.values())

    @property
    def observation_features(self) -> int:
        """Size of one observation, D."""
        return self.history_shape[1]

    @property
    def out_features(self) -> int:
        """Size of all estimates together."""
        return sum(self.targets.values())

    @property
    def estimate_keys(self) -> list[NestedKey]:
        """Keys of the estimates, in the order of the targets: what an estimator must write."""
        keys = {"intrinsic": self.keys.intrinsic_estimate, "extrinsic": self.keys.extrinsic_estimate}
        return [keys[target] for target in self.targets]

    @property
    def scale_keys(self) -> list[NestedKey]:
        """Keys of the estimates' standard deviations, in the same order: what one that gives a distribution writes."""
        keys = {"intrinsic": self.keys.intrinsic_scale, "extrinsic": self.keys.extrinsic_scale}
        return [keys[target] for target in self.targets]

    @property
    def next_observation_key(self) -> NestedKey:
        """Key of the next observation in collected steps, for losses alone."""
        key = self.keys.observation
        return ("next", key) if isinstance(key, str) else ("next", *key)

    @property
    def state_key(self) -> str:
        """Key of a hidden state, which an estimator with a memory reads; it writes :attr:`next_state_key`."""
        return f"{self.role}_estimator_state"

    @property
    def next_state_key(self) -> tuple[str, str]:
        """Key under which a hidden state is written for the next step."""
        return ("next", self.state_key)

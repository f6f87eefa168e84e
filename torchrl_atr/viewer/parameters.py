"""Intrinsic parameters that a user has chosen for robots of an env: written at once, and again after falls."""

from __future__ import annotations

from collections.abc import Iterable

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from torchrl_atr._errors import InputError
from torchrl_atr.envs.access import base_env
from torchrl_atr.modules import NetworkKeys

OFFERED = ("payload", "friction")
"""Parameters that a page shows, where the task has them."""
_INTRINSIC = NetworkKeys().intrinsic


class Parameters:
    """Chosen intrinsic parameters of robots, which a new episode would draw anew.

    Args:
        env: a QuadrupedEnv, transformed or not.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> env = make_riding_env(num_envs=2, seed=0)
        >>> parameters = Parameters(env)
        >>> parameters.choose(1, "payload", 2.0, env.reset())
        >>> parameters.values(1)["payload"]
        (0.0, 3.0, 2.0)
    """

    def __init__(self, env: EnvBase) -> None:
        self._base = base_env(env)
        self._chosen: dict[int, dict[str, float]] = {}

    def values(self, row: int) -> dict[str, tuple[float, float, float]]:
        """Return lowest, highest and present value of a robot's payload (kg) and friction, where it has them."""
        intrinsics = self._base.runner.intrinsics
        values = intrinsics.values(self._base.runner.x_int)
        return {
            name: (*intrinsics.parameters[name].test, float(values[name][row, 0]))
            for name in OFFERED
            if name in intrinsics.parameters
        }

    def choose(self, row: int, name: str, value: float, td: TensorDictBase) -> None:
        """Set a parameter of a robot; its motion goes on.

        Args:
            row: which robot.
            name: of the parameter.
            value: in its unit.
            td: the env's present entries, which hold the parameters, too.

        Raises:
            InputError: for a parameter that the task does not have, or that has several components.
        """
        slices = self._base.runner.intrinsics.slices
        single = [each for each, columns in slices.items() if columns.stop - columns.start == 1]
        if name not in single:
            raise InputError(
                f"there is no intrinsic parameter {name!r} of one number; choose among {', '.join(single)}"
            )
        self._chosen.setdefault(row, {})[name] = float(value)
        self.apply([row], td)

    def apply(self, rows: Iterable[int], td: TensorDictBase) -> None:
        """Write what was chosen for robots into their models and into the env's present entries."""
        chosen = [row for row in rows if row in self._chosen]
        if not chosen:
            return
        intrinsics, state = self._base.runner.intrinsics, self._base.get_state()
        for row in chosen:
            for name, value in self._chosen[row].items():
                state["x_int"][row, intrinsics.slices[name]] = intrinsics.parameters[name].scaled(value)
        if _INTRINSIC in state["emitted"].keys(True, True):
            state["emitted"].set(_INTRINSIC, state["x_int"].clone())
        self._base.set_state(state)
        td.set(_INTRINSIC, state["x_int"].clone())

"""RL-ATR on TorchRL: quadrupeds that learn to ride tilt-driven personal transporters.

Importing this package is light: MuJoCo, dm_control and the plotting libraries load with the part that needs them
(:mod:`torchrl_atr.envs`, :mod:`torchrl_atr.modules`, :mod:`torchrl_atr.objectives`, ...). :mod:`torchrl_atr.deploy`
runs policies without torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchrl_atr.deploy.loading import load_policy

__all__ = ["__version__", "load_policy"]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import what needs torch at its first use."""
    if name == "load_policy":
        from torchrl_atr.deploy.loading import load_policy

        return load_policy
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""RL-ATR on TorchRL: quadrupeds that learn to ride tilt-driven personal transporters.

Importing this package is light: MuJoCo, dm_control and the plotting libraries load with the part that needs them
(:mod:`torchrl_atr.envs`, :mod:`torchrl_atr.modules`, :mod:`torchrl_atr.objectives`, ...).
"""

__version__ = "0.1.0.dev0"

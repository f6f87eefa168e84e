"""Engines: N simulations of a scene behind one interface, and a task's hook before every substep."""

from torchrl_atr.envs.physics.choice import make_engine
from torchrl_atr.envs.physics.engine import CONTROL_DT, DECIMATION, Engine, ModelFields
from torchrl_atr.envs.physics.hook import SubstepHook
from torchrl_atr.envs.physics.simulation import EngineName, Simulation

__all__ = [
    "CONTROL_DT",
    "DECIMATION",
    "Engine",
    "EngineName",
    "ModelFields",
    "Simulation",
    "SubstepHook",
    "make_engine",
]

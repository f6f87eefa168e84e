"""Engines: N simulations of a scene behind one interface, and a task's hook before every substep."""

from torchrl_atr.envs.physics.choice import EngineName, make_engine
from torchrl_atr.envs.physics.engine import CONTROL_DT, DECIMATION, Engine, ModelFields
from torchrl_atr.envs.physics.hook import SubstepHook

__all__ = ["CONTROL_DT", "DECIMATION", "Engine", "EngineName", "ModelFields", "SubstepHook", "make_engine"]

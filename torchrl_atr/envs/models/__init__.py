"""What exists: robots, transporters, and the scene that joins them."""

from torchrl_atr.envs.models.robot import LEGS, ROBOTS, RobotSpec
from torchrl_atr.envs.models.scene import Layout, Scene, build_scene, scene_spec
from torchrl_atr.envs.models.transporter import TRANSPORTERS, TransporterSpec

__all__ = [
    "LEGS",
    "ROBOTS",
    "TRANSPORTERS",
    "Layout",
    "RobotSpec",
    "Scene",
    "TransporterSpec",
    "build_scene",
    "scene_spec",
]

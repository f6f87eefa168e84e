"""Models: robots, their supports, and the scene that joins them."""

from torchrl_atr.envs.models.boards import Transporter, TransporterLayout
from torchrl_atr.envs.models.loading import load_robot_model
from torchrl_atr.envs.models.robot import LEGS, ROBOTS, RobotError, RobotSpec, register_robot
from torchrl_atr.envs.models.robot_file import get_robot, read_robot
from torchrl_atr.envs.models.saving import scene_xml
from torchrl_atr.envs.models.scene import Layout, Scene, build_scene, scene_mjspec
from torchrl_atr.envs.models.support import FlatGround, Support
from torchrl_atr.envs.models.transporter import (
    SINGLE_BOARD,
    TRANSPORTER_DESIGNS,
    TRANSPORTERS,
    TWO_BOARD,
    Board,
    Hinge,
    TransporterDesign,
    TransporterError,
    TransporterSpec,
    get_transporter,
    read_transporter,
)

__all__ = [
    "LEGS",
    "ROBOTS",
    "SINGLE_BOARD",
    "TRANSPORTERS",
    "TRANSPORTER_DESIGNS",
    "TWO_BOARD",
    "Board",
    "FlatGround",
    "Hinge",
    "Layout",
    "RobotError",
    "RobotSpec",
    "Scene",
    "Support",
    "Transporter",
    "TransporterDesign",
    "TransporterError",
    "TransporterLayout",
    "TransporterSpec",
    "build_scene",
    "get_robot",
    "get_transporter",
    "load_robot_model",
    "read_robot",
    "read_transporter",
    "register_robot",
    "scene_mjspec",
    "scene_xml",
]

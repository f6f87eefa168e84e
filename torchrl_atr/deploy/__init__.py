"""Deployment: policy bundles, and their runtime, which needs NumPy and ONNX Runtime alone.

What is exported here imports no torch; :mod:`torchrl_atr.deploy.export`, which writes bundles, and
:mod:`torchrl_atr.deploy.loading`, which loads them into TorchRL, do. :mod:`torchrl_atr.deploy.simulation` is a robot in
plain MuJoCo.
"""

from torchrl_atr.deploy.manifest import BundleError, policies, read_manifest
from torchrl_atr.deploy.parity import Parity, verify
from torchrl_atr.deploy.readings import Imu, without_gravity
from torchrl_atr.deploy.robot import Robot, RobotState, run_policy
from torchrl_atr.deploy.runner import Gains, JointCommand, PolicyRunner

__all__ = [
    "BundleError",
    "Gains",
    "Imu",
    "JointCommand",
    "Parity",
    "PolicyRunner",
    "Robot",
    "RobotState",
    "policies",
    "read_manifest",
    "run_policy",
    "verify",
    "without_gravity",
]

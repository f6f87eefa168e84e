"""Table II's rows of the robot and its feet: their ranges, and the functions that write them to the model."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

from torch import Tensor

from torchrl_atr._checks import check_pair
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.scene import Scene, columns
from torchrl_atr.envs.physics.engine import ModelFields
from torchrl_atr.envs.tasks import mirrors
from torchrl_atr.envs.tasks.intrinsic_parameters import Apply, IntrinsicParameter

TABLE_II_KP, TABLE_II_KD = 40.0, 1.0
"""Midpoints of Table II's ranges, N m/rad and N m s/rad, for every robot if A13 is read literally."""


Gains = tuple[float, float]
"""Nominal stiffness, N m/rad, and damping, N m s/rad, of every joint's PD controller; 0 for the robot's own."""


def with_gains(robot: RobotSpec, gains: Gains | None) -> RobotSpec:
    """Return a robot with other nominal PD gains.

    Raises:
        InputError: unless they are two numbers, 0 or more.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS
        >>> with_gains(ROBOTS.get("a1"), (60.0, 0.0)).kp
        60.0
    """
    kp, kd = (0.0, 0.0) if gains is None else check_pair("gains", gains, "two numbers (kp, kd)", positive=False)
    return dataclasses.replace(robot, kp=kp or robot.kp, kd=kd or robot.kd) if kp or kd else robot


def gain_arguments(gains: Gains | None) -> dict[str, Any]:
    """Return the entry of a task's ``arguments`` for given gains; empty for the robot's own."""
    return {} if gains is None or not any(gains) else {"gains": list(gains)}


def payload(fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Add a mass to the trunk, kg, (n, 1); its inertia grows in proportion."""
    trunk = scene.layout.trunk_body
    scale_body(fields, trunk, 1.0 + value[:, 0] / fields["body_mass"][:, trunk])


def com_shift(fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Move the trunk's centre of mass, m, (n, 3)."""
    fields["body_ipos"][:, scene.layout.trunk_body].add_(value)


def kp(fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Set the PD stiffness of every joint, N m/rad, (n, 12)."""
    actuators = columns(scene.layout.actuators)
    fields["actuator_gainprm"][:, actuators, 0] = value
    fields["actuator_biasprm"][:, actuators, 1] = -value


def kd(fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Set the PD damping of every joint, N m s/rad, (n, 12)."""
    actuators = columns(scene.layout.actuators)
    fields["actuator_biasprm"][:, actuators, 2] = -value


def friction(fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Set the sliding friction between feet and support, (n, 1)."""
    fields["geom_friction"][:, columns(scene.layout.support_geoms), 0] = value


def scale_body(fields: ModelFields, body: int, scale: Tensor) -> None:
    """Multiply a body's mass and inertia by a factor, (n,)."""
    fields["body_mass"][:, body].mul_(scale)
    fields["body_inertia"][:, body].mul_(scale[:, None])


def scaled(function: Apply, unit: float | Tensor, fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Apply a parameter whose values are ratios to a nominal value of robot or transporter."""
    function(fields, value * unit, scene)


def robot_parameters(robot: RobotSpec, interpretation: Interpretation) -> dict[str, IntrinsicParameter]:
    """Return Table II's rows of the robot and its feet, by name in its order; ``interpretation`` answers A13."""
    stiffness, damping = (robot.kp, robot.kd) if interpretation.gains_as_ratios else (TABLE_II_KP, TABLE_II_KD)
    return {
        "payload": IntrinsicParameter(payload, (0.0, 1.0), (0.0, 3.0), 0.0),
        "com_shift": IntrinsicParameter(com_shift, (-0.2, 0.2), (-0.25, 0.25), 0.0, 3, mirrors.POLAR),
        "kp": IntrinsicParameter(
            partial(scaled, kp, stiffness), (0.9, 1.1), (0.8, 1.2), 1.0, "joints", mirrors.joint_gains
        ),
        "kd": IntrinsicParameter(
            partial(scaled, kd, damping), (0.8, 1.2), (0.6, 1.4), 1.0, "joints", mirrors.joint_gains
        ),
        "friction": IntrinsicParameter(friction, (0.8, 1.2), (0.7, 1.5), 1.0),
    }

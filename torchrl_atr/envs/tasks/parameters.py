"""How intrinsic parameters that any robot has reach the compiled model (Table II's first half)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.physics.engine import ModelFields


def payload(fields: ModelFields, rows: Tensor, value: Tensor, scene: Scene) -> None:
    """Add a mass to the trunk, kg, (n, 1); its inertia grows in proportion."""
    trunk = scene.layout.trunk_body
    scale_body(fields, rows, trunk, 1.0 + value[:, 0] / fields["body_mass"][rows, trunk])


def com_shift(fields: ModelFields, rows: Tensor, value: Tensor, scene: Scene) -> None:
    """Move the trunk's centre of mass, m, (n, 3)."""
    fields["body_ipos"][rows, scene.layout.trunk_body] += value


def kp(fields: ModelFields, rows: Tensor, value: Tensor, scene: Scene) -> None:
    """Set the PD stiffness of every joint, N m/rad, (n, 12)."""
    each, actuators = rows[:, None], torch.as_tensor(scene.layout.actuators)
    fields["actuator_gainprm"][each, actuators, 0] = value
    fields["actuator_biasprm"][each, actuators, 1] = -value


def kd(fields: ModelFields, rows: Tensor, value: Tensor, scene: Scene) -> None:
    """Set the PD damping of every joint, N m s/rad, (n, 12)."""
    actuators = torch.as_tensor(scene.layout.actuators)
    fields["actuator_biasprm"][rows[:, None], actuators, 2] = -value


def friction(fields: ModelFields, rows: Tensor, value: Tensor, scene: Scene) -> None:
    """Set the sliding friction between feet and support, (n, 1)."""
    geoms = torch.as_tensor(scene.layout.support_geoms)
    fields["geom_friction"][rows[:, None], geoms, 0] = value


def scale_body(fields: ModelFields, rows: Tensor, body: int, scale: Tensor) -> None:
    """Multiply a body's mass and inertia by a factor, (n,)."""
    fields["body_mass"][rows, body] *= scale
    fields["body_inertia"][rows, body] *= scale[:, None]

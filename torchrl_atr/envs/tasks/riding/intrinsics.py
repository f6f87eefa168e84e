"""Table II: the intrinsic parameters x_int of robot and transporter, and the functions that write them to the model."""

from __future__ import annotations

import math
from functools import partial

import torch
from torch import Tensor

from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.models.transporter import Board, TransporterError, TransporterSpec
from torchrl_atr.envs.physics.engine import ModelFields
from torchrl_atr.envs.tasks.intrinsic_parameters import IntrinsicParameter
from torchrl_atr.envs.tasks.parameters import robot_parameters, scale_body, scaled

_MIN_MASS_SHARE = 0.1
"""Smallest mass of a transporter as a share of its nominal mass (A14)."""


def riding_intrinsics(
    robot: RobotSpec, transporter: TransporterSpec, interpretation: Interpretation
) -> dict[str, IntrinsicParameter]:
    """Return Table II's parameters by name, in its order; self-balancing gains are ratios of their ranges' midpoints.

    Args:
        robot: its nominal gains.
        transporter: its nominal mass and springs.
        interpretation: the self-balancing gains' unit and scale (A12), the PD gains' (A13).
    """
    own = robot_parameters(robot, interpretation)
    friction = own.pop("friction")
    stiffness, damping = (torch.from_numpy(values) for values in transporter.springs(interpretation))
    springs = (0.8 / 1.15, 1.5 / 1.15), (0.5 / 1.15, 2.0 / 1.15)
    return {
        **own,
        "platform_mass": IntrinsicParameter(_platform_mass, (-0.5, 0.5), (-1.0, 1.0), 0.0),
        "friction": friction,
        "sb_stiffness": IntrinsicParameter(partial(scaled, _stiffness, stiffness), *springs, 1.0, 2, _sides),
        "sb_damping": IntrinsicParameter(partial(scaled, _damping, damping), (0.8, 1.2), (0.4, 2.0), 1.0, 2, _sides),
    }


def _platform_mass(fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Add a mass to the boards together, kg, (n, 1); their inertia grows in proportion."""
    nominal = scene.support.spec.mass
    share = (nominal + value[:, 0]).clamp_min(_MIN_MASS_SHARE * nominal) / nominal
    for body in scene.support_layout.board_bodies:
        scale_body(fields, int(body), share)


def _stiffness(fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Set the hinges' stiffness, N m/rad, in Table II's order (roll, pitch; or right, left), (n, 2)."""
    layout = scene.support_layout
    fields["jnt_stiffness"][:, layout.tilt_joints] = value[:, layout.tilt_gains]


def _damping(fields: ModelFields, value: Tensor, scene: Scene) -> None:
    """Set the hinges' damping, N m s/rad, likewise, (n, 2)."""
    layout = scene.support_layout
    fields["dof_damping"][:, layout.tilt_dof] = value[:, layout.tilt_gains]


def _sides(scene: Scene) -> Tensor:
    """Return R of Table II's two gains, (2, 2): roll and pitch stay, those of a right and a left board swap.

    Raises:
        TransporterError: if the left boards are not the mirror image of the right ones.
    """
    spec: TransporterSpec = scene.support.spec
    matrix, boards = torch.zeros(2, 2, dtype=torch.float32), spec.design.boards
    for board in boards:
        mirrored = next((other for other in boards if _mirror_images(board, other)), None)
        if mirrored is None:
            raise TransporterError(
                f"transporter {spec.name!r}: board {board.name!r} has no mirror image on the other side; "
                "add it, or train with symmetric=false"
            )
        for hinge, partner in zip(board.hinges, mirrored.hinges):
            matrix[partner.gain, hinge.gain] = 1.0
            for name in ("sb_stiffness", "sb_damping"):
                values = getattr(spec, name)
                if not math.isclose(values[hinge.gain], values[partner.gain], rel_tol=1e-3, abs_tol=1e-12):
                    raise TransporterError(
                        f"transporter {spec.name!r}: {name} of {hinge.name!r} and {partner.name!r} are "
                        f"{values[hinge.gain]:g} and {values[partner.gain]:g}; give both sides the same, or train with "
                        "symmetric=false"
                    )
    for gain in range(2):
        if not matrix[gain].any():  # a gain without a hinge
            matrix[gain, gain] = 1.0
    return matrix


def _mirror_images(board: Board, other: Board) -> bool:
    alike = [hinge.axis for hinge in board.hinges] == [hinge.axis for hinge in other.hinges]
    return alike and math.isclose(board.offset, -other.offset) and math.isclose(board.share, other.share)

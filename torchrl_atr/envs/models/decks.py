"""The transporter's part of a scene: planar joints that the drive law moves, and boards that the rider tilts."""

from __future__ import annotations

import mujoco
import numpy as np

from torchrl_atr.envs.models.transporter import Board, TransporterSpec
from torchrl_atr.envs.profiles import Readings

DECK_HEIGHT = 0.15
"""Height of the boards' centre above the floor, m: the altitude controller holds it (no vertical joint)."""
PLATFORM = "platform"
"""Body whose frame is P_planar."""
PLANAR_JOINTS = ("platform_x", "platform_y", "platform_yaw")
_HUB_MASS = 1e-9
"""MuJoCo refuses a moving body without mass; the armature of its joints is what counts."""


def add_transporter(spec: mujoco.MjSpec, transporter: TransporterSpec, readings: Readings, armature: float) -> None:
    """Adds the boards of a transporter on one planar pivot P.

    Args:
        spec: a scene.
        transporter: what to add.
        readings: the unit and scale of the self-balancing gains (A12).
        armature: of the planar joints, kg and kg m².
    """
    hub = spec.worldbody.add_body(name=PLATFORM, pos=[0, 0, DECK_HEIGHT])
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, kind, axis in zip(PLANAR_JOINTS, (slide, slide, hinge), np.eye(3)):
        hub.add_joint(name=name, type=kind, axis=axis, armature=armature)
    boards = transporter.design.boards
    if len(boards) == 1:
        _add_board(hub, boards[0], transporter, readings)
        return
    hub.mass, hub.inertia, hub.explicitinertial = _HUB_MASS, [_HUB_MASS] * 3, True
    hub.ipos = hub.pos  # what MuJoCo takes where nothing is said; it saves an inertia with a position alone
    for board in boards:
        body = hub.add_body(name=board.name, pos=[0, board.offset * transporter.size[1], 0])
        _add_board(body, board, transporter, readings)


def _add_board(body: mujoco.MjsBody, board: Board, transporter: TransporterSpec, readings: Readings) -> None:
    body.add_geom(
        name=board.name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[side / 2 for side in transporter.board_size(board)],
        mass=board.share * transporter.mass,
        rgba=[0.25, 0.45, 0.62, 1] if board.offset <= 0 else [0.32, 0.53, 0.7, 1],
        contype=0,
        conaffinity=1,
        # the board's contact parameters rule: one friction coefficient to randomise
        priority=1,
        friction=[1.0, 0.005, 0.0001],
        solref=[0.01, 1.0],
        condim=3,
    )
    stiffness, damping = transporter.springs(readings)
    for hinge in board.hinges:
        joint = body.add_joint(name=hinge.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis)
        joint.stiffness = [stiffness[hinge.gain], 0, 0]
        joint.damping = [damping[hinge.gain], 0, 0]

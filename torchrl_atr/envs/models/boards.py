"""Transporter as a support: planar joints that the drive law moves, and boards that the robot tilts."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models.support import Support, touch
from torchrl_atr.envs.models.transporter import Board, TransporterSpec

BOARD_HEIGHT = 0.15
"""Height of the boards' centre above the floor, m: the altitude controller holds it (no vertical joint)."""
PIVOT = "platform"
"""Body whose frame is P_planar."""
PLANAR_JOINTS = ("platform_x", "platform_y", "platform_yaw")
_PIVOT_MASS = 1e-9
"""Mass and inertia of the pivot: MuJoCo rejects a moving body without mass; its joints' armature dominates."""
_ARMATURE_RATIO = 200.0
# The planar joints have an armature of 200 robot masses: even large reaction forces (random actions of
# standard deviation 1) change the prescribed speed by less than 1 mm/s, and the solver, whose tolerance
# scales with the trace of the inertia matrix, still converges.


@dataclass(frozen=True)
class TransporterLayout:
    """Addresses of a transporter's parts in ``qpos``, ``qvel`` and the model's fields.

    Attributes:
        planar_qpos, planar_dof: of x, y and yaw, (3,).
        tilt_qpos, tilt_dof, tilt_joints: of the hinges in the design's order, (hinges,).
        tilt_gains: index of each hinge's gain among Table II's two, (hinges,).
        board_bodies, board_geoms: of the boards, (boards,).
    """

    planar_qpos: NDArray[np.int64]
    planar_dof: NDArray[np.int64]
    tilt_qpos: NDArray[np.int64]
    tilt_dof: NDArray[np.int64]
    tilt_joints: NDArray[np.int64]
    tilt_gains: NDArray[np.int64]
    board_bodies: NDArray[np.int64]
    board_geoms: NDArray[np.int64]


@dataclass(frozen=True)
class Transporter(Support):
    """Transporter as a support; see :class:`~torchrl_atr.envs.models.support.Support`.

    Attributes:
        spec: its design and measures.
        interpretation: the unit and scale of the self-balancing gains (A12).

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS, build_scene
        >>> scene = build_scene(ROBOTS.get("a1"), Transporter(TRANSPORTERS.get("single_board_g1")))
        >>> scene.support_layout.tilt_dof.tolist()
        [21, 22]
    """

    spec: TransporterSpec
    interpretation: Interpretation = dataclasses.field(default_factory=Interpretation)

    kind = "transporter"
    contact = (mujoco.mjtObj.mjOBJ_XBODY, PIVOT)
    origin = PLANAR_JOINTS[:2]
    joints = PLANAR_JOINTS

    @property
    def name(self) -> str:
        """Name of the spec."""
        return self.spec.name

    @property
    def size(self) -> tuple[float, float]:
        """Length and width of all boards together, m."""
        return self.spec.size[0], self.spec.size[1]

    @property
    def height(self) -> float:
        """Height of the boards' top above the floor, m."""
        return BOARD_HEIGHT + self.spec.size[2] / 2

    @property
    def geoms(self) -> tuple[str, ...]:
        """Names of the boards' geoms."""
        return tuple(board.name for board in self.spec.design.boards)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the pivot and, where there are several, the boards."""
        boards = self.spec.design.boards
        return (PIVOT,) if len(boards) == 1 else (PIVOT, *(board.name for board in boards))

    def build(self, spec: mujoco.MjSpec, robot_mass: float) -> None:
        """Add the boards on one planar pivot P."""
        pivot = spec.worldbody.add_body(name=PIVOT, pos=[0, 0, BOARD_HEIGHT])
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        for name, kind, axis in zip(PLANAR_JOINTS, (slide, slide, hinge), np.eye(3)):
            pivot.add_joint(name=name, type=kind, axis=axis, armature=_ARMATURE_RATIO * robot_mass)
        boards = self.spec.design.boards
        if len(boards) == 1:
            self._add_board(pivot, boards[0])
            return
        pivot.mass, pivot.inertia, pivot.explicitinertial = _PIVOT_MASS, [_PIVOT_MASS] * 3, True
        pivot.ipos = pivot.pos  # MuJoCo's default, written out: it saves an inertia only with a position
        for board in boards:
            body = pivot.add_body(name=board.name, pos=[0, board.offset * self.spec.size[1], 0])
            self._add_board(body, board)

    def _add_board(self, body: mujoco.MjsBody, board: Board) -> None:
        geom = body.add_geom(
            name=board.name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[side / 2 for side in self.spec.board_size(board)],
            mass=board.share * self.spec.mass,
            rgba=[0.25, 0.45, 0.62, 1] if board.offset <= 0 else [0.32, 0.53, 0.7, 1],
        )
        touch(geom)
        stiffness, damping = self.spec.springs(self.interpretation)
        for hinge in board.hinges:
            joint = body.add_joint(name=hinge.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis)
            joint.stiffness = [stiffness[hinge.gain], 0, 0]
            joint.damping = [damping[hinge.gain], 0, 0]

    def locate(self, model: mujoco.MjModel) -> TransporterLayout:
        """Return the addresses of the planar joints, the hinges and the boards."""
        planar = np.array([model.joint(name).id for name in PLANAR_JOINTS])
        hinges = self.spec.design.hinges
        tilt = np.array([model.joint(hinge.name).id for hinge in hinges])
        boards = np.array([model.geom(name).id for name in self.geoms])
        return TransporterLayout(
            planar_qpos=model.jnt_qposadr[planar],
            planar_dof=model.jnt_dofadr[planar],
            tilt_qpos=model.jnt_qposadr[tilt],
            tilt_dof=model.jnt_dofadr[tilt],
            tilt_joints=tilt,
            tilt_gains=np.array([hinge.gain for hinge in hinges]),
            board_bodies=model.geom_bodyid[boards],
            board_geoms=boards,
        )

    def describe(self) -> dict[str, Any]:
        """Return the spec's fields except its name."""
        facts = dataclasses.asdict(self.spec)
        del facts["name"]
        return facts

"""The mirror image of a ride: how a reflection in the robot's sagittal plane acts on what is observed and done."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
import torch
from tensordict import NestedKey
from torch import Tensor

from torchrl_atr.envs.models.mirror import find_asymmetry
from torchrl_atr.envs.models.robot import JOINTS_PER_LEG, LEGS
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.models.transporter import Board, TransporterError, TransporterSpec
from torchrl_atr.envs.profiles import Readings
from torchrl_atr.envs.task import observations, outlook, randomization

POLAR, AXIAL = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0)
"""Signs of a vector's components (forward, left, up): a position or velocity, and an angular velocity."""
FORWARD_YAW = (1.0, -1.0)
"""Signs of a forward speed and a yaw rate."""


def reflections(scene: Scene, readings: Readings) -> dict[NestedKey, Tensor]:
    """How left and right change places in every observation and in the action.

    A ride and its mirror image obey the same physics and earn the same reward, up to the order in which a solver adds
    numbers: observing, acting and reflecting commute.

    Args:
        scene: robot and transporter.
        readings: which components the extrinsic state has (A1).

    Returns:
        By key the matrix R, (D, D), that makes the mirror image R x; a signed permutation that undoes itself.

    Raises:
        RobotError, TransporterError: if the left legs or boards are not the mirror image of the right ones, in
            geometry, masses or joints.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS, build_scene
        >>> mirror = reflections(build_scene(ROBOTS.get("a1"), TRANSPORTERS.get("single_board_g1")), Readings())
        >>> (mirror["speeds"] @ torch.tensor([1.0, 0.5])).tolist()
        [1.0, -0.5]
    """
    legs, joints = _sides_swapped(), _joints(scene)
    gains = _gains(scene.transporter)
    parts: dict[str, Tensor] = {
        "acceleration": _signs(POLAR),
        "angular_velocity": _signs(AXIAL),
        "orientation": _signs(AXIAL[:2]),
        "joint_position": joints,
        "joint_velocity": joints,
        "contacts": legs,
        "body_velocity": _signs(POLAR),
        "platform_velocity": _signs(POLAR),
        "platform_angular_velocity": _signs(AXIAL),
        "relative_position": _signs(POLAR[:2]),
        "relative_yaw": _signs(AXIAL[2:]),
        "payload": _eye(1),
        "com_shift": _signs(POLAR),
        "kp": joints.abs(),
        "kd": joints.abs(),
        "platform_mass": _eye(1),
        "friction": _eye(1),
        "sb_stiffness": gains,
        "sb_damping": gains,
    }
    command = _signs(FORWARD_YAW)
    proprio = torch.block_diag(*(parts[name] for name in observations.PROPRIO), joints)
    extrinsic = (parts[name] for name in observations.extrinsic_components(readings))
    errors_and_kernels = [command, *[_eye(2)] * len(outlook.HORIZONS)]
    return {
        "proprio": proprio,
        "command": command,
        "speeds": command,
        "odometry": _signs(POLAR),
        "observation": torch.block_diag(proprio, command),
        ("privileged", "intrinsic"): torch.block_diag(*(parts[name] for name in randomization.INTRINSICS)),
        ("privileged", "extrinsic"): torch.block_diag(*extrinsic),
        ("privileged", "outlook"): torch.block_diag(_signs((-1.0, 1.0)), command, *errors_and_kernels),
        "action": joints,
    }


def _eye(size: int) -> Tensor:
    """The identity, float32 whatever torch's default."""
    return torch.eye(size, dtype=torch.float32)


def _signs(values: Sequence[float]) -> Tensor:
    return torch.diag(torch.tensor(values, dtype=torch.float32))


def _sides_swapped() -> Tensor:
    """Of one number a leg, (4, 4): front left for front right, and so on."""
    other = {"R": "L", "L": "R"}
    return _eye(len(LEGS))[[LEGS.index(leg[0] + other[leg[1]]) for leg in LEGS]]


def _joints(scene: Scene) -> Tensor:
    """Of one angle a joint, (12, 12); a hinge's sign follows from its axis and its partner's."""
    model, robot = scene.model, scene.robot
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    axes = np.stack([data.xaxis[model.joint(name).id] for name in robot.joints])
    partner = torch.kron(_sides_swapped(), _eye(JOINTS_PER_LEG)).argmax(-1)
    signs = torch.from_numpy((axes * AXIAL * axes[partner]).sum(-1))
    matrix = torch.diag(signs.round())[partner].T.float()
    q0 = torch.tensor(robot.q0, dtype=torch.float32)
    alike = torch.isclose(signs.abs(), signs.new_ones(())) & torch.isclose(matrix @ q0, q0, atol=1e-3)
    if not alike.all():
        odd = int(alike.logical_not().nonzero()[0])
        raise robot.error(
            f"joint {robot.joints[odd]!r} is not the mirror image of {robot.joints[int(partner[odd])]!r}, in its axis "
            "or its angle in q0; correct that, or train with symmetric=false"
        )
    difference = find_asymmetry(model, robot, matrix.sum(-1).numpy())
    if difference is not None:
        raise robot.error(
            f"{difference.left} is not the mirror image of {difference.right}: {difference.what}; correct "
            "that, or train with symmetric=false"
        )
    return matrix


def _gains(deck: TransporterSpec) -> Tensor:
    """Of Table II's two self-balancing gains, (2, 2): roll and pitch stay, those of a right and a left board swap."""
    matrix, boards = torch.zeros(2, 2, dtype=torch.float32), deck.design.boards
    for board in boards:
        mirrored = next((other for other in boards if _mirror_images(board, other)), None)
        if mirrored is None:
            raise TransporterError(
                f"transporter {deck.name!r}: board {board.name!r} has no mirror image on the other side; "
                "add it, or train with symmetric=false"
            )
        for hinge, partner in zip(board.hinges, mirrored.hinges):
            matrix[partner.gain, hinge.gain] = 1.0
            for name in ("sb_stiffness", "sb_damping"):
                values = getattr(deck, name)
                if not math.isclose(values[hinge.gain], values[partner.gain], rel_tol=1e-3, abs_tol=1e-12):
                    raise TransporterError(
                        f"transporter {deck.name!r}: {name} of {hinge.name!r} and {partner.name!r} are "
                        f"{values[hinge.gain]:g} and {values[partner.gain]:g}; give both sides the same, or train with "
                        "symmetric=false"
                    )
    return matrix


def _mirror_images(board: Board, other: Board) -> bool:
    alike = [hinge.axis for hinge in board.hinges] == [hinge.axis for hinge in other.hinges]
    return alike and math.isclose(board.offset, -other.offset) and math.isclose(board.share, other.share)

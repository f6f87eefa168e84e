"""Mirror images: how a reflection in the robot's sagittal plane acts on what is observed and done."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import torch
from torch import Tensor

from torchrl_atr.envs.models.mirror import find_asymmetry
from torchrl_atr.envs.models.robot import JOINTS_PER_LEG, LEGS
from torchrl_atr.envs.models.scene import Scene

Mirror = Sequence[float] | Callable[[Scene], Tensor]
"""The mirror image R x of a quantity x of D components: signs, (D,), if R is diagonal, or a function of the scene that
returns R, (D, D), such as :func:`joints`."""
POLAR, AXIAL = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0)
"""Signs of a vector's components (forward, left, up): a position or velocity, and an angular velocity."""
FORWARD_YAW = (1.0, -1.0)
"""Signs of a forward speed and a yaw rate."""


def matrix(mirror: Mirror, scene: Scene) -> Tensor:
    """Return R, (D, D), float32.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
        >>> scene = build_scene(ROBOTS.get("a1"), FlatGround())
        >>> (matrix(FORWARD_YAW, scene) @ torch.tensor([1.0, 0.5])).tolist()
        [1.0, -0.5]
    """
    if callable(mirror):
        return mirror(scene)
    return torch.diag(torch.tensor(mirror, dtype=torch.float32))


def legs(scene: Scene) -> Tensor:
    """Return R of one number a leg, (4, 4): front left for front right, and so on."""
    return _sides_swapped()


def joints(scene: Scene) -> Tensor:
    """Return R of one angle a joint, (12, 12); a hinge's sign follows from its axis and its partner's.

    Raises:
        RobotError: if the left legs are not the mirror image of the right ones, in geometry, masses or joints.
    """
    model, robot = scene.model, scene.robot
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    axes = np.stack([data.xaxis[model.joint(name).id] for name in robot.joints])
    partner = torch.kron(_sides_swapped(), _eye(JOINTS_PER_LEG)).argmax(-1)
    signs = torch.from_numpy((axes * AXIAL * axes[partner]).sum(-1))
    image = torch.diag(signs.round())[partner].T.float()
    q0 = torch.tensor(robot.q0, dtype=torch.float32)
    alike = torch.isclose(signs.abs(), signs.new_ones(())) & torch.isclose(image @ q0, q0, atol=1e-3)
    if not alike.all():
        odd = int(alike.logical_not().nonzero()[0])
        raise robot.error(
            f"joint {robot.joints[odd]!r} is not the mirror image of {robot.joints[int(partner[odd])]!r}, in its axis "
            "or its angle in q0; correct that, or train with symmetric=false"
        )
    difference = find_asymmetry(model, robot, image.sum(-1).numpy())
    if difference is not None:
        raise robot.error(
            f"{difference.left} is not the mirror image of {difference.right}: {difference.what}; correct "
            "that, or train with symmetric=false"
        )
    return image


def joint_gains(scene: Scene) -> Tensor:
    """Return R of one positive number a joint, (12, 12): sides change places, signs stay.

    Raises:
        RobotError: see :func:`joints`.
    """
    return joints(scene).abs()


def _eye(size: int) -> Tensor:
    """Return the identity, float32 whatever torch's default."""
    return torch.eye(size, dtype=torch.float32)


def _sides_swapped() -> Tensor:
    """Return the permutation of legs, (4, 4)."""
    other = {"R": "L", "L": "R"}
    return _eye(len(LEGS))[[LEGS.index(leg[0] + other[leg[1]]) for leg in LEGS]]

"""Mirror images: reflections of observations and actions in the robot's sagittal plane."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import torch
from torch import Tensor

from torchrl_atr._errors import InputError, UserError, first_line
from torchrl_atr.envs.models.mirror import find_asymmetry
from torchrl_atr.envs.models.robot import JOINTS_PER_LEG, LEGS
from torchrl_atr.envs.models.scene import Scene

Mirror = Sequence[float] | Callable[[Scene], Tensor]
"""Mirror image R x of a quantity x of D components: signs, (D,), if R is diagonal, or a function of the scene that
returns R, (D, D), such as :func:`joints`."""
POLAR, AXIAL = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0)
"""Signs of a vector's components (forward, left, up): a position or velocity, and an angular velocity."""
FORWARD_YAW = (1.0, -1.0)
"""Signs of a forward speed and a yaw rate."""


def matrix(mirror: Mirror, scene: Scene, size: int, what: str, error: type[InputError] = InputError) -> Tensor:
    """Return R, (D, D), float32.

    Args:
        mirror: see :data:`Mirror`.
        scene: robot and support.
        size: D.
        what: name of the quantity, for messages.
        error: exception type to raise.

    Raises:
        InputError: (or ``error``) names the quantity whose mirror image has another size or is invalid: R is a signed
            permutation that undoes itself.
        UserError: whatever a mirror that is a function raises, such as RobotError of :func:`joints`.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
        >>> scene = build_scene(ROBOTS.get("a1"), FlatGround())
        >>> (matrix(FORWARD_YAW, scene, 2, "the command") @ torch.tensor([1.0, 0.5])).tolist()
        [1.0, -0.5]
    """
    try:
        made = mirror(scene) if callable(mirror) else torch.diag(torch.as_tensor(mirror, dtype=torch.float32))
        image = torch.as_tensor(made, dtype=torch.float32)
    except UserError:  # of a robot that is not symmetric
        raise
    except Exception as failure:  # of the user's function, or of a value that is not a list of signs
        reason = f"{type(failure).__name__}: {first_line(failure)}"
        raise error(f"the mirror image of {what} failed: {reason}; give signs, or a function of the scene") from failure
    if tuple(image.shape) != (size, size):
        raise error(f"the mirror image of {what} is of {tuple(image.shape)}; it has {size} components")
    if not (torch.equal(image.abs().sum(0), image.new_ones(size)) and torch.equal(image @ image, _eye(size))):
        raise error(
            f"the mirror image of {what} is no signed permutation that undoes itself; give signs of 1.0 or -1.0"
        )
    return image


def legs(scene: Scene) -> Tensor:
    """Return R of one number per leg, (4, 4): front left for front right, and so on."""
    return _sides_swapped()


def joints(scene: Scene) -> Tensor:
    """Return R of one angle per joint, (12, 12); a hinge's sign follows from its axis and its partner's.

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
    """Return R of one positive number per joint, (12, 12): sides are swapped, signs stay.

    Raises:
        RobotError: see :func:`joints`.
    """
    return joints(scene).abs()


def _eye(size: int) -> Tensor:
    """Return the identity matrix as float32, whatever torch's default dtype."""
    return torch.eye(size, dtype=torch.float32)


def _sides_swapped() -> Tensor:
    """Return the permutation of legs, (4, 4)."""
    other = {"R": "L", "L": "R"}
    return _eye(len(LEGS))[[LEGS.index(leg[0] + other[leg[1]]) for leg in LEGS]]

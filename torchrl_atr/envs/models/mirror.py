"""Comparison of a robot's left half with the mirror image of its right one, for ``symmetric=true``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.models.feet import find_feet, reach
from torchrl_atr.envs.models.robot import JOINTS_PER_LEG, LEGS, RobotSpec

MASS_TOLERANCE = 0.02
"""Relative tolerance of masses. All tolerances allow for rounding in public models, too small to affect riding."""
LENGTH_TOLERANCE = 0.003
"""Tolerance of joints, feet and centres of mass of the legs, m; the calves of the public Go1 differ by 0.002."""
TRUNK_TOLERANCE = 0.01
"""Largest distance of the trunk's centre of mass from the plane of symmetry, m."""
INERTIA_TOLERANCE = 0.05
"""Tolerance of a link's inertia tensor, relative to its largest moment."""
ANGLE_TOLERANCE = 0.06
"""Tolerance of ranges and springs, rad; the ranges of the public Spot differ by 0.05."""
JOINT_TOLERANCE = 0.01
"""Relative tolerance of armature, damping, friction loss, stiffness and force limits."""
_PARTNERS = tuple((LEGS.index(f"{end}L"), LEGS.index(f"{end}R")) for end in "FR")
_FLIP = np.array([1.0, -1.0, 1.0])
Array = NDArray[np.float64]


class Difference(NamedTuple):
    """Two parts that should be mirror images, and their difference.

    Attributes:
        left, right: names of the parts.
        what: the difference, with the values of both, in this order.
    """

    left: str
    right: str
    what: str


class _Link(NamedTuple):
    """Rigid link in the trunk's frame: mass, centre of mass, inertia about it."""

    mass: float
    com: Array
    inertia: Array


def find_asymmetry(model: mujoco.MjModel, robot: RobotSpec, signs: Array) -> Difference | None:
    """Find the first difference between the right half of a robot and the mirror image of its left half.

    Compares, with the tolerances of this module, joint by joint: anchors, ranges, armature, damping, friction loss,
    springs and force limits; link by link: mass, centre of mass and inertia, parts welded to it included; the feet's
    geoms; and the trunk with itself.

    Args:
        model: the scene.
        robot: its spec; its joint axes and q0 mirror each other.
        signs: +1 or -1 by joint, the factor that mirrors its angle, (12,).
    """
    return next(_differences(model, robot, signs), None)


def _differences(model: mujoco.MjModel, robot: RobotSpec, signs: Array) -> Iterator[Difference]:
    data = mujoco.MjData(model)
    data.qpos[[int(model.joint(name).qposadr[0]) for name in robot.joints]] = robot.q0
    root = int(model.joint(int(model.body(robot.trunk).jntadr[0])).qposadr[0])
    data.qpos[root : root + 7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(model, data)
    trunk = model.body(robot.trunk).id
    yield from _compare_trunk(robot, _link(model, data, trunk))
    for left, right in _PARTNERS:
        for i in range(JOINTS_PER_LEG):
            pair = [leg * JOINTS_PER_LEG + i for leg in (left, right)]
            names = [robot.joints[joint] for joint in pair]
            ids = [model.joint(name).id for name in names]
            for what in _compare_joints(model, data, ids, float(signs[pair[0]])):
                yield Difference(names[0], names[1], what)
            links = [_link(model, data, int(model.jnt_bodyid[joint])) for joint in ids]
            for what in _compare_links(*links):
                yield Difference(f"the link of {names[0]}", f"the link of {names[1]}", what)
    feet = find_feet(model, robot)
    for left, right in _PARTNERS:
        for what in _compare_feet(model, data, feet[left], feet[right]):
            yield Difference(f"foot {LEGS[left]}", f"foot {LEGS[right]}", what)


def _link(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> _Link:
    """Return the link of ``root`` and all bodies welded to it."""
    bodies = np.flatnonzero(model.body_weldid == root)
    masses = model.body_mass[bodies]
    total = float(masses.sum())
    com = masses @ data.xipos[bodies] / total if total else data.xpos[root].copy()
    inertia = np.zeros((3, 3))
    for body, mass in zip(bodies, masses):
        axes, offset = data.ximat[body].reshape(3, 3), data.xipos[body] - com
        inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return _Link(total, com, inertia)


def _compare_trunk(robot: RobotSpec, trunk: _Link) -> Iterator[Difference]:
    halves = (f"the left half of {robot.trunk!r}", "its right half")
    if abs(trunk.com[1]) > TRUNK_TOLERANCE:
        yield Difference(*halves, f"its centre of mass is {trunk.com[1]:.4g} m to the left")
    products = trunk.inertia[1, [0, 2]]
    if np.abs(products).max() > INERTIA_TOLERANCE * trunk.inertia.max():
        yield Difference(*halves, f"its products of inertia Ixy and Iyz are {_list(products)} kg m²")


def _compare_joints(model: mujoco.MjModel, data: mujoco.MjData, ids: list[int], sign: float) -> Iterator[str]:
    left, right = ids
    if not _near(data.xanchor[right], data.xanchor[left] * _FLIP, LENGTH_TOLERANCE):
        yield f"anchors at {_list(data.xanchor[left])} and {_list(data.xanchor[right])} m in the trunk's frame"
    limited = model.jnt_limited[ids]
    mirrored = np.sort(sign * model.jnt_range[left])
    if limited[0] != limited[1] or (limited[0] and not _near(model.jnt_range[right], mirrored, ANGLE_TOLERANCE)):
        shown = (_list(model.jnt_range[i]) + " rad" if model.jnt_limited[i] else "none" for i in ids)
        yield "ranges {} and {}".format(*shown)
    dofs = model.jnt_dofadr[ids]
    for name, values in {
        "armature": model.dof_armature[dofs],
        "damping": np.column_stack([model.dof_damping[dofs], model.dof_dampingpoly[dofs]]),
        "frictionloss": model.dof_frictionloss[dofs],
        "stiffness": np.column_stack([model.jnt_stiffness[ids], model.jnt_stiffnesspoly[ids]]),
        "actuatorfrcrange": np.where(model.jnt_actfrclimited[ids], model.jnt_actfrcrange[ids][:, 1], np.inf),
    }.items():
        if not np.allclose(values[0], values[1], rtol=JOINT_TOLERANCE, atol=1e-9):
            yield f"{name} {_list(values[0])} and {_list(values[1])}"
    rest = model.qpos_spring[model.jnt_qposadr[ids]]
    if model.jnt_stiffness[ids].any() and abs(rest[0] - sign * rest[1]) > ANGLE_TOLERANCE:
        yield f"springref {rest[0]:.4g} and {rest[1]:.4g} rad"


def _compare_links(left: _Link, right: _Link) -> Iterator[str]:
    if abs(right.mass - left.mass) > MASS_TOLERANCE * max(right.mass, left.mass):
        yield f"masses {left.mass:.4g} and {right.mass:.4g} kg"
    if not _near(right.com, left.com * _FLIP, LENGTH_TOLERANCE):
        yield f"centres of mass at {_list(left.com)} and {_list(right.com)} m in the trunk's frame"
    mirrored = left.inertia * np.outer(_FLIP, _FLIP)
    if not _near(right.inertia, mirrored, INERTIA_TOLERANCE * max(right.inertia.max(), left.inertia.max())):
        shown = (_list(link.inertia[np.triu_indices(3)]) for link in (left, right))
        yield "inertias (xx, xy, xz, yy, yz, zz) {} and {} kg m²".format(*shown)


def _compare_feet(
    model: mujoco.MjModel, data: mujoco.MjData, left: tuple[int, ...], right: tuple[int, ...]
) -> Iterator[str]:
    if len(right) != len(left):
        yield f"{len(left)} and {len(right)} colliding geoms"
        return
    boxes = [_extent(model, data, foot) for foot in (left, right)]
    if not _near(boxes[0], np.sort(boxes[1] * _FLIP, axis=0), LENGTH_TOLERANCE):
        shown = [" to ".join(_list(corner) for corner in box) for box in boxes]
        yield f"geoms that fill {shown[0]} and {shown[1]} m in the trunk's frame"


def _extent(model: mujoco.MjModel, data: mujoco.MjData, foot: tuple[int, ...]) -> Array:
    """Return the corners of the bounding box of a foot, m, (2, 3)."""
    low, high = [], []
    for geom in foot:
        axes, centre = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        low.append(centre - [reach(model, geom, -axis) for axis in axes])
        high.append(centre + [reach(model, geom, axis) for axis in axes])
    return np.stack([np.min(low, axis=0), np.max(high, axis=0)])


def _near(one: Array, other: Array, tolerance: float) -> bool:
    return bool((np.abs(one - other) <= tolerance).all())


def _list(values: Array) -> str:
    """Format a number, or several in brackets."""
    shown = ", ".join(f"{value:.4g}" for value in np.atleast_1d(values))
    return f"[{shown}]" if np.size(values) > 1 else shown

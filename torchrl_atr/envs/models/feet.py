"""Geoms of a robot's feet: those that its spec names, and adjacent ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.models.robot import RobotSpec

FOOT_SHARE = 0.75
"""Share of the way from a leg's last joint to the named geom beyond which a colliding geom is part of the foot."""


def foot_positions(data: mujoco.MjData, feet: Sequence[Sequence[int]]) -> NDArray[np.float64]:
    """Return the position of each foot, the mean of its geoms' centres, in current kinematics, m, (4, 3)."""
    return np.stack([data.geom_xpos[list(foot)].mean(0) for foot in feet])


def find_feet(model: mujoco.MjModel, robot: RobotSpec) -> tuple[tuple[int, ...], ...]:
    """Find the geoms of each foot: they bear load together; contact of any other geom is a collision.

    An entry of ``robot.feet`` that is a list names all of them. An entry that is one name stands for that geom and for
    the other colliding geoms of the same rigid link that are

    - on its body, or on one welded to that, where the body is a foot alone: without a joint, welded to the calf;
    - or wholly in the link's last quarter, measured from its joint to the centre of the named geom;
    - or nowhere nearer to that joint than the named geom is.

    So a sole, heel and toe count, and a shank on the same body does not.

    Args:
        model: compiled, with the robot in it.
        robot: its feet must exist.

    Returns:
        Geom ids by leg, in the order of ``LEGS``; the named ones first.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return tuple(
        (model.geom(foot).id, *_others(model, data, model.geom(foot).id))
        if isinstance(foot, str)
        else tuple(model.geom(name).id for name in foot)
        for foot in robot.feet
    )


def _others(model: mujoco.MjModel, data: mujoco.MjData, named: int) -> list[int]:
    """Return the other colliding geoms of the foot of ``named``."""
    body = int(model.geom_bodyid[named])
    link = int(model.body_weldid[body])
    hinges = model.jnt_bodyid == link
    hinges &= model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    if not hinges.any():
        return []
    joint = data.xanchor[np.flatnonzero(hinges)[-1]]
    way = data.geom_xpos[named] - joint
    length = float(np.linalg.norm(way))
    if length == 0:
        return []
    way /= length

    def near_end(geom: int) -> float:
        back = reach(model, geom, -way @ data.geom_xmat[geom].reshape(3, 3))
        return float((data.geom_xpos[geom] - joint) @ way) - back

    limit = min(FOOT_SHARE * length, near_end(named)) - 1e-9
    foot_alone = _subtree(model, body) if body != link else set()
    candidates = (model.body_weldid[model.geom_bodyid] == link) & (model.geom_contype != 0)
    return [
        geom
        for geom in np.flatnonzero(candidates).tolist()
        if geom != named and (int(model.geom_bodyid[geom]) in foot_alone or near_end(geom) >= limit)
    ]


def _subtree(model: mujoco.MjModel, root: int) -> set[int]:
    bodies = {root}
    for body in range(root + 1, model.nbody):  # parents come first
        if int(model.body_parentid[body]) in bodies:
            bodies.add(body)
    return bodies


def reach(model: mujoco.MjModel, geom: int, direction: NDArray[np.float64]) -> float:
    """Return the extent of a geom from its centre in a direction, m; exact for every convex type.

    Args:
        model: model with the geom.
        geom: id.
        direction: unit vector in the geom's frame, (3,).
    """
    size, kinds = model.geom_size[geom], mujoco.mjtGeom
    match kinds(model.geom_type[geom]):
        case kinds.mjGEOM_CAPSULE:
            return float(size[0] + size[1] * abs(direction[2]))
        case kinds.mjGEOM_CYLINDER:
            return float(size[0] * math.hypot(direction[0], direction[1]) + size[1] * abs(direction[2]))
        case kinds.mjGEOM_BOX:
            return float(np.abs(direction) @ size)
        case kinds.mjGEOM_ELLIPSOID:
            return float(np.linalg.norm(direction * size))
        case kinds.mjGEOM_MESH:
            mesh = model.mesh(int(model.geom_dataid[geom]))
            vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
            return float((vertices @ direction).max())
        case _:
            return float(size[0])

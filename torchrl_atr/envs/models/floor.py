"""Checkered floor in renderings: physics keeps board and robot at the origin, the floor shows the distance."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

_TILES = 25
"""Texture repetitions after which positions wrap: near enough for OpenGL's float32, and seldom."""


def floor_planes(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the ids of fixed planes, in a scene its floor."""
    return np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0))


def floor_period(model: mujoco.MjModel) -> float:
    """Return the period of the floor's texture, m.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
        >>> floor_period(build_scene(ROBOTS.get("a1"), FlatGround()).model)
        4.0
    """
    materials = [model.geom_matid[plane] for plane in floor_planes(model) if model.geom_matid[plane] >= 0]
    repeats = [float(model.mat_texrepeat[i, 0]) for i in materials if model.mat_texuniform[i]]
    return 2.0 / repeats[0] if repeats else 2.0  # MuJoCo's texture coordinates on a plane run from -1 to 1


def near_origin(position: ArrayLike, period: float) -> NDArray[np.float64]:
    """Return the position near the origin at which an endless floor looks as it does at ``position``.

    Args:
        position: in the world, m, (*B, 2).
        period: of the floor, m.

    Returns:
        (*B, 2): the position less a multiple of 25 periods, within half of that.

    Example:
        >>> near_origin([30.0, -1003.5], 4.0).tolist()
        [30.0, -3.5]
    """
    span = _TILES * period
    position = np.asarray(position, dtype=np.float64)
    return position - span * np.rint(position / span)

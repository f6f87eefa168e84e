"""Supports: the interface that a scene needs, and flat ground."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import mujoco

FLOOR = "floor"
"""Geom of every scene: a plane at height 0, without contacts unless a support enables them."""
SOLREF = (0.01, 1.0)
"""Time constant, s, and damping ratio of contacts with feet."""


class Support(ABC):
    """Interface of the support under a robot: a transporter, the ground, or your own.

    Example:
        >>> class Plate(Support):  # fixed to the world, half a metre up
        ...     name, kind, size, height, geoms = "plate", "plate", (2.0, 2.0), 0.5, ("plate",)
        ...     contact = mujoco.mjtObj.mjOBJ_GEOM, "plate"
        ...
        ...     def build(self, spec, robot_mass):
        ...         box = mujoco.mjtGeom.mjGEOM_BOX
        ...         touch(spec.worldbody.add_geom(name="plate", type=box, size=[1, 1, 0.05], pos=[0, 0, 0.45]))
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Name in messages and models."""

    @property
    @abstractmethod
    def kind(self) -> str:
        """Name of this part in descriptions of a scene, such as ``"transporter"``."""

    @property
    @abstractmethod
    def geoms(self) -> tuple[str, ...]:
        """Names of the geoms that feet touch; their friction applies."""

    @property
    @abstractmethod
    def contact(self) -> tuple[mujoco.mjtObj, str]:
        """Type and name of the MuJoCo object whose contacts with the robot are measured."""

    @property
    def size(self) -> tuple[float, float] | None:
        """Length and width of the surface, m; None if it has no end."""
        return None

    @property
    def height(self) -> float:
        """Height of the surface above the floor while the robot stands, m."""
        return 0.0

    @property
    def origin(self) -> tuple[str, ...]:
        """Names of the two slide joints (x, y) of the support's position; empty for a fixed one.

        The simulation is kept near the world's origin by moving support and robot back together.
        """
        return ()

    @property
    def endless(self) -> bool:
        """Translation invariance: whether moving the robot alone in the plane changes nothing, as on flat ground."""
        return False

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the support's bodies, from the world outwards; cameras follow the first, or the robot."""
        return ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of joints that descriptions of a scene leave out."""
        return ()

    @abstractmethod
    def build(self, spec: mujoco.MjSpec, robot_mass: float) -> None:
        """Add the support to a scene, which has a floor already; ``robot_mass`` is in kg."""

    def locate(self, model: mujoco.MjModel) -> Any:
        """Return the addresses of the support's parts in the compiled model."""
        return None

    def describe(self) -> dict[str, Any]:
        """Return the parameters of the support's behaviour, as plain values."""
        return {}


@dataclass(frozen=True)
class FlatGround(Support):
    """Support by the floor: endless, level, with one friction coefficient.

    Attributes:
        name: of the support.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, build_scene
        >>> build_scene(ROBOTS.get("a1"), FlatGround()).model.nv  # six of the trunk, twelve joints
        18
    """

    name: str = "flat_ground"

    kind = "ground"
    contact = (mujoco.mjtObj.mjOBJ_GEOM, FLOOR)
    geoms = (FLOOR,)
    endless = True

    def build(self, spec: mujoco.MjSpec, robot_mass: float) -> None:
        """Enable contacts of the floor, see :class:`Support`."""
        touch(spec.geom(FLOOR))


def touch(geom: mujoco.MjsGeom) -> None:
    """Enable contacts of a geom with the robot, by this geom's contact parameters: one friction to randomise."""
    geom.contype, geom.conaffinity = 0, 1
    geom.priority = 1
    geom.friction = [1.0, 0.005, 0.0001]
    geom.solref = list(SOLREF)
    geom.condim = 3

"""Robots in a viser scene: MuJoCo's geoms become meshes once, then only poses are sent; arrows of the velocities."""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.models.floor import near_origin
from torchrl_atr.viewer.poses import ChaseFrame
from torchrl_atr.viewer.session import Session

if TYPE_CHECKING:
    from viser import ViserServer

Array = NDArray[np.float64]
CAMERA = (-2.5, 0.9, 1.7)
"""Where a browser's camera begins: behind the robot, to the left of it; looks at :data:`LOOK_AT`."""
LOOK_AT = (0.2, 0.35, 0.1)
_CELL, _SECTION = 0.5, 2.0
_COMMANDED, _ACTUAL = (40, 110, 220), (235, 120, 30)
_HEIGHTS = {"commanded": 0.75, "actual": 0.82}  # m: over the robot, where boards and legs do not hide them
_HORIZON = 0.8  # s of motion that an arrow shows
_POINTS = 9


class SceneDisplay:
    """Display of a session's robots around the followed one, which stays in the middle.

    The scene moves and turns, not the cameras: each browser looks from where its user has put it.

    Args:
        server: of the page.
        session: whose robots are shown.
    """

    def __init__(self, server: ViserServer, session: Session) -> None:
        from mjviser import ViserMujocoScene

        self._frame = ChaseFrame()
        server.scene.configure_default_lights()
        # mjviser writes its own scales into the model
        self._robots = ViserMujocoScene(server, copy.copy(session.poses.model), session.setup.robots)
        self._robots.camera_tracking_enabled = False
        self._robots.fixed_bodies_frame.visible = False  # its floor cannot move under the robot: ours does
        self._floor = server.scene.add_grid(
            "/floor",
            infinite_grid=True,
            cell_size=_CELL,
            section_size=_SECTION,
            cell_color=(205, 210, 216),
            section_color=(150, 158, 168),
            fade_distance=25.0,
            plane_color=(240, 243, 246),
            plane_opacity=1.0,
            shadow_opacity=0.25,
        )
        self._arrows = [VelocityArrow(server, "commanded", _COMMANDED), VelocityArrow(server, "actual", _ACTUAL)]

    def update(self, session: Session, dt: float) -> None:
        """Send the present poses to all browsers.

        Args:
            session: after a step.
            dt: seconds since the last call, for the lag of the turning.
        """
        poses, row = session.poses.read(), session.followed
        self._frame.follow(poses.places[row], float(poses.headings[row]), dt)
        rotation, yaw = self._frame.rotation, self._frame.yaw or 0.0
        self._robots.update_from_arrays(self._frame.to_frame(poses.positions), rotation @ poses.rotations)
        self._floor.position = rotation @ [*-near_origin(self._frame.place, _SECTION), 0.0]
        self._floor.wxyz = (math.cos(yaw / 2), 0.0, 0.0, -math.sin(yaw / 2))
        actual = session.command if session.reading is None else session.reading.actual
        for arrow, velocity in zip(self._arrows, (session.command, actual)):
            arrow.point(np.asarray(velocity, dtype=float), float(poses.headings[row]) - yaw)


class VelocityArrow:
    """Arrow over the robot along the path that a speed and a yaw rate make in the next moments.

    Args:
        server: of the page.
        name: of its nodes in the scene.
        color: RGB.
    """

    def __init__(self, server: ViserServer, name: str, color: tuple[int, int, int]) -> None:
        self._height = _HEIGHTS[name]
        points = self._points(np.zeros(2), 0.0)
        path = np.stack([points[:-1], points[1:]], 1)
        self._path = server.scene.add_line_segments(f"/velocity/{name}/path", path, color, thickness=0.03)
        self._head = server.scene.add_arrows(
            f"/velocity/{name}/head", path[-1:], color, shaft_radius=0.015, head_radius=0.05, head_length=0.1
        )

    def _points(self, velocity: Array, heading: float) -> Array:
        return np.pad(arc(velocity, heading), ((0, 0), (0, 1)), constant_values=self._height)

    def point(self, velocity: Array, heading: float) -> None:
        """Point along a velocity.

        Args:
            velocity: m/s and rad/s, (2,).
            heading: of the robot in the scene, rad.
        """
        points = self._points(velocity, heading)
        self._path.points = np.stack([points[:-1], points[1:]], 1).astype(np.float32)
        self._head.points = points[None, -2:].astype(np.float32)
        self._head.visible = self._path.visible = abs(float(velocity[0])) > 0.02


def arc(velocity: Array, heading: float = 0.0) -> Array:
    """Return points of the path from the origin at a constant speed and yaw rate, m, (:data:`_POINTS`, 2).

    Args:
        velocity: m/s and rad/s, (2,).
        heading: at the origin, rad.

    Example:
        >>> arc(np.array([1.0, 0.0]))[-1].tolist()
        [0.8, 0.0]
        >>> bool(arc(np.array([1.0, 0.5]))[-1, 1] > 0)  # a positive yaw rate turns to the left
        True
    """
    times = np.linspace(0.0, _HORIZON, _POINTS)
    # sinc keeps the chord's length exact without a division by the yaw rate
    half = velocity[1] * times / 2
    chord, direction = velocity[0] * times * np.sinc(half / np.pi), heading + half
    return np.stack([chord * np.cos(direction), chord * np.sin(direction)], -1)

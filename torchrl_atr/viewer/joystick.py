"""Joystick in the scene: a stick that is dragged over a pad with the mastered commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from torchrl_atr.viewer.area import CommandArea, pad_picture

if TYPE_CHECKING:
    from viser import ViserServer

CENTRE = (0.0, 1.15, 0.03)
"""Middle of the pad in the scene, m: to the left of the followed robot."""
SIZE = 1.1
"""Its side, m."""
_STICK, _RADIUS, _LIFT = (30, 60, 120), 0.07, 0.05
_QUARTER = math.sqrt(0.5)
Told = Callable[[float, float], object]


class Joystick:
    """Pad on the floor beside the robot, with a stick at the command: forward is more speed, left turns left.

    Dragging the stick or clicking the pad asks for a command. The stick stays where it is let go.

    Args:
        server: of the page.
        told: called with speed (m/s) and yaw rate (rad/s), in a thread of the server.
    """

    def __init__(self, server: ViserServer, told: Told) -> None:
        self._server, self._told = server, told
        self._limits = (1.0, 1.0)

    def show(self, area: CommandArea | None, limits: tuple[float, float]) -> None:
        """Put a pad into the scene.

        Args:
            area: mastered commands to draw on it.
            limits: |c_v| and |c_ω| at its edges.
        """
        self._limits = limits
        scene = self._server.scene
        turned = (_QUARTER, 0.0, 0.0, -_QUARTER)  # the picture's top is ahead, its left side on the left
        picture = pad_picture(area, limits)[::-1]  # viser's pictures have y downwards, as cameras do
        pad = scene.add_image("/joystick/pad", picture, SIZE, SIZE, wxyz=turned, position=CENTRE, cast_shadow=False)
        self._stick = scene.add_icosphere("/joystick/stick", _RADIUS, _STICK, position=self._place(0.0, 0.0))
        for fraction, text in ((0.5, f"{limits[0]:.3g} m/s"), (-0.5, f"-{limits[0]:.3g} m/s")):
            self._label(f"speed{fraction > 0}", text, (fraction * 1.12, 0.0))
        self._label("left", f"{limits[1]:.3g} rad/s", (0.0, 0.58))
        self._stick.on_drag("left")(self._dragged)
        pad.on_click(self._clicked)

    def _label(self, name: str, text: str, place: tuple[float, float]) -> None:
        position = (CENTRE[0] + SIZE * place[0], CENTRE[1] + SIZE * place[1], CENTRE[2])
        self._server.scene.add_label(f"/joystick/{name}", text, position=position, anchor="center-center")

    def _place(self, speed: float, yaw_rate: float) -> tuple[float, float, float]:
        along, across = (value / limit if limit else 0.0 for value, limit in zip((speed, yaw_rate), self._limits))
        along, across = max(-1.0, min(1.0, along)), max(-1.0, min(1.0, across))
        return CENTRE[0] + along * SIZE / 2, CENTRE[1] + across * SIZE / 2, CENTRE[2] + _LIFT

    def move(self, command: tuple[float, float]) -> None:
        """Put the stick at a command."""
        self._stick.position = self._place(*command)

    async def _dragged(self, event: Any) -> None:
        if event.phase != "start":
            self._ask(event.client.camera.position, event.end_position, _LIFT)

    async def _clicked(self, event: Any) -> None:
        origin, direction = np.asarray(event.ray_origin), np.asarray(event.ray_direction)
        self._ask(origin, origin + direction, 0.0)

    def _ask(self, eye: ArrayLike, point: ArrayLike, height: float) -> None:
        command = command_at(eye, point, self._limits, height)
        if command is not None:
            self._told(*command)


def command_at(
    eye: ArrayLike, point: ArrayLike, limits: tuple[float, float], height: float = 0.0
) -> tuple[float, float] | None:
    """Return the command where the line of sight through a point meets a plane over the pad, clipped to the pad.

    Args:
        eye: the camera, m, (3,).
        point: m, (3,).
        limits: |c_v| and |c_ω| at the pad's edges.
        height: of the plane over the pad, m: that of the stick's centre, where that is dragged.

    Returns:
        Speed and yaw rate; None if the line goes upwards.

    Example:
        >>> command_at((CENTRE[0], CENTRE[1], 2.0), (CENTRE[0] + SIZE / 4, CENTRE[1] - SIZE, CENTRE[2]), (2.0, 1.0))
        (1.0, -1.0)
    """
    start, towards = np.asarray(eye, dtype=float), np.asarray(point, dtype=float)
    fall = towards[2] - start[2]
    if fall >= -1e-9:
        return None
    met = start + (CENTRE[2] + height - start[2]) / fall * (towards - start)
    shares = np.clip((met[:2] - CENTRE[:2]) / (SIZE / 2), -1.0, 1.0).round(6)
    return float(shares[0] * limits[0]), float(shares[1] * limits[1])

"""Offscreen rendering of one robot of an env: OpenGL without a display, a camera that follows, a caption."""

from __future__ import annotations

import copy
import ctypes.util
import importlib
import math
import os
import sys
import warnings
from types import TracebackType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from torchrl.envs import EnvBase

from torchrl_atr._errors import InputError, UserError
from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.models.floor import floor_period, near_origin

CHASE = "chase"
"""Camera that follows the board from behind and turns with a lag, so that turning is visible."""
_BACKENDS = {"egl": "mujoco.egl", "osmesa": "mujoco.osmesa", "glfw": "mujoco.glfw"}
_TURNING_TIME = 1.5  # s
_NO_GL = (
    "cannot render with MUJOCO_GL={name}: {reason}. Without a display, install libegl1 (MUJOCO_GL=egl) "
    "or libosmesa6 (MUJOCO_GL=osmesa), for example: apt-get install libegl1 libgl1-mesa-dri"
)


class DisplayError(UserError, RuntimeError):
    """Error of a machine that cannot display or render; the message names the remedy."""


def has_display() -> bool:
    """Return whether a window can be opened on this machine."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def gl_backend() -> str:
    """Return ``MUJOCO_GL`` if set; else glfw with a display, egl without (osmesa where only that is installed)."""
    named = os.environ.get("MUJOCO_GL", "").strip().lower()
    if named in _BACKENDS:
        return named
    if has_display():
        return "glfw"
    only_osmesa = not ctypes.util.find_library("EGL") and ctypes.util.find_library("OSMesa")
    return "osmesa" if only_osmesa else "egl"


def _make_contexts(model: mujoco.MjModel, size: tuple[int, int]) -> tuple[Any, mujoco.MjrContext]:
    # not mujoco.Renderer: its backend is chosen when mujoco is first imported, too early for a default here
    name = gl_backend()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # glfw warns of what the error says
            context = importlib.import_module(_BACKENDS[name]).GLContext(*size)
            context.make_current()
            return context, mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
    except Exception as error:  # PyOpenGL raises whatever went wrong: AttributeError, ImportError, GLError, ...
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DisplayError(_NO_GL.format(name=name, reason=reason)) from error


class OffscreenRenderer:
    """Renderer of one robot of an env; a context manager.

    The env keeps board and robot at the origin; the board's offset in the world is added back, so that it moves over
    the floor: see :class:`SceneView`.

    Args:
        env: a QuadrupedEnv, transformed or not.
        size: width and height, pixels; at most the scene's offscreen buffer, 1280 x 960.
        camera: ``"chase"``, or the name of a camera of the model.
        row: index of the robot.

    Raises:
        DisplayError: if this machine cannot render; names what to install.
        TypeError: if the env is not a QuadrupedEnv below its transforms.
        InputError: if the picture is too large, or there is no such camera.
    """

    def __init__(self, env: EnvBase, size: tuple[int, int] = (640, 480), camera: str = CHASE, row: int = 0) -> None:
        self._view = SceneView(env, row)
        model = self._view.model
        largest = model.vis.global_.offwidth, model.vis.global_.offheight
        if not (0 < size[0] <= largest[0] and 0 < size[1] <= largest[1]):
            raise InputError(f"size={size}: choose width and height up to {largest}")
        self._camera = self._find_camera(model, camera)
        self._free = camera == CHASE
        self._heading: float | None = None
        self._context, self._mjr = _make_contexts(model, size)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)
        self._scene, self._option = mujoco.MjvScene(model, maxgeom=2000), mujoco.MjvOption()
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0  # half the time of a picture in software
        self._viewport = mujoco.MjrRect(0, 0, *size)

    @staticmethod
    def _find_camera(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        if name == CHASE:
            camera.type, camera.distance, camera.elevation = mujoco.mjtCamera.mjCAMERA_FREE, 2.6, -18.0
            return camera
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if number < 0:
            known = {CHASE, *(model.camera(i).name for i in range(model.ncam))}
            raise InputError(f"unknown camera {name!r}; choose one of {', '.join(sorted(known))}")
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, number
        return camera

    def render(self, text: str = "", values: str = "", dt: float = 0.04) -> NDArray[np.uint8]:
        """Render the robot's current state.

        Args:
            text: left column of a caption at the top left, lines separated by line breaks.
            values: its right column.
            dt: seconds since the last picture, for the camera's lag.

        Returns:
            (height, width, 3) uint8, RGB.
        """
        self._view.update()
        if self._free:
            self._follow(dt)
        model, data = self._view.model, self._view.data
        self._context.make_current()
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateCamera(model, data, self._camera, self._scene)  # the floor is laid out around the last camera
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._scene)
        mujoco.mjr_render(self._viewport, self._scene, self._mjr)
        if text:
            font, corner = mujoco.mjtFont.mjFONT_NORMAL, mujoco.mjtGridPos.mjGRID_TOPLEFT
            mujoco.mjr_overlay(font, corner, self._viewport, text, values, self._mjr)
        image = np.empty((self._viewport.height, self._viewport.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(image, None, self._viewport, self._mjr)
        return image[::-1]

    def _follow(self, dt: float) -> None:
        x, y, heading = self._view.pose()
        if self._heading is None:
            self._heading = heading
        behind = math.remainder(heading - self._heading, math.tau)  # a reset or set_state may turn it back
        self._heading += behind * min(1.0, dt / _TURNING_TIME)
        self._camera.lookat[:] = [x, y, 0.3]
        self._camera.azimuth = np.degrees(self._heading) + 35.0

    def close(self) -> None:
        """Free the OpenGL context; at the interpreter's exit this would print errors."""
        if self._context is not None:
            self._mjr.free()
            self._context.free()
            self._context = None

    def __enter__(self) -> OffscreenRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class SceneView:
    """Separate MuJoCo model and data that show one robot of an env at its place on the floor.

    Positions are those in the world less a whole number of the floor's tiles, within 50 m of the origin: the
    picture is the same, and float32, in which OpenGL computes, does not jitter after kilometres.

    Args:
        env: a QuadrupedEnv, transformed or not, with any engine.
        row: index of the robot.

    Raises:
        TypeError: if the env is not a QuadrupedEnv below its transforms.
    """

    def __init__(self, env: EnvBase, row: int = 0) -> None:
        base = base_env(env)
        if not hasattr(base, "engine"):
            raise TypeError(f"{type(base).__name__} has no MuJoCo engine to show; use a QuadrupedEnv")
        self.engine, self.row = base.engine, row
        # the randomised parameters (masses, gains, friction) are invisible, so the nominal model is enough
        self.model: mujoco.MjModel = copy.copy(base.model)
        # the shadow map covers the extent: of the board alone, its edge would run through the picture
        self.model.stat.extent, self.model.vis.quality.shadowsize = 3.0, 2048
        self.data = mujoco.MjData(self.model)
        self._period = floor_period(self.model)
        self.update()

    def update(self) -> None:
        """Copy the robot's configuration from the env."""
        engine = self.engine
        self.data.qpos[:] = engine.qpos[self.row].numpy()
        place = near_origin(engine.world_offset[self.row].numpy(), self._period)
        for addresses in engine.scene.layout.carried_qpos:
            self.data.qpos[addresses] += place
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        self.data.light_xpos[:, :2] += self.pose()[:2]  # the light moves with the robot, or it would leave its shadows

    def pose(self) -> tuple[float, float, float]:
        """Return position (m, less a whole number of tiles) and heading (rad) of the body that the camera follows."""
        body = self.engine.scene.layout.followed_body
        (x, y, _), rotation = self.data.xpos[body], self.data.xmat[body]
        return float(x), float(y), float(np.arctan2(rotation[3], rotation[0]))

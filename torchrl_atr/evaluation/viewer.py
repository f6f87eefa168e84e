"""Real-time rides in MuJoCo's viewer, commanded from the keyboard or by a fixed sequence of commands."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.access import command_limits
from torchrl_atr.evaluation.rendering import DisplayError, SceneView, has_display
from torchrl_atr.evaluation.video import Command, ride_with_resets

_FOREVER = 10**9


class Keyboard:
    """Command set by the arrow keys: up and down change the speed, left and right the yaw rate, space stops.

    It is a sequence of one command, the current one, and can replace a fixed sequence.

    Args:
        limits: largest |c_v| (m/s) and |c_ω| (rad/s).
        step: change per key press, m/s and rad/s.
        lowest: smallest c_v and c_ω; None for the negative of ``limits``.

    Example:
        >>> keyboard = Keyboard()
        >>> keyboard(Keyboard.UP)
        >>> keyboard[0]
        (0.0, 0.25, 0.0)
    """

    SPACE, RIGHT, LEFT, DOWN, UP = 32, 262, 263, 264, 265  # GLFW's codes

    def __init__(
        self, limits: ArrayLike = (2.0, 1.0), step: tuple[float, float] = (0.25, 0.25), lowest: ArrayLike | None = None
    ) -> None:
        self.limits, self.step = np.array(limits), np.array(step)
        self.lowest = -self.limits if lowest is None else np.array(lowest)
        self.command = np.zeros(2)

    def __call__(self, key: int) -> None:
        """Handle a key press."""
        moves = {self.UP: (1, 0), self.DOWN: (-1, 0), self.LEFT: (0, 1), self.RIGHT: (0, -1)}
        if key == self.SPACE:
            self.command = np.zeros(2)
        elif key in moves:
            self.command = np.clip(self.command + self.step * moves[key], self.lowest, self.limits)

    def __len__(self) -> int:
        return 1

    def __getitem__(self, index: int) -> Command:
        if index not in (0, -1):
            raise IndexError(index)
        return 0.0, float(self.command[0]), float(self.command[1])


def play_viewer(
    policy: TensorDictModuleBase,
    env: EnvBase,
    commands: Sequence[Command] | None = None,
    seconds: float | None = None,
) -> None:
    """Show the env's first robot riding, until the window is closed.

    Args:
        policy: writes the action; its deterministic action is taken.
        env: of :func:`~torchrl_atr.envs.make_riding_env`.
        commands: (second, c_v in m/s, c_ω in rad/s); by default the arrow keys and space set them.
        seconds: duration; None for no limit.

    Raises:
        DisplayError: if there is no display; suggests a video.
    """
    if not has_display():
        raise DisplayError(
            "there is no display for the viewer (DISPLAY is not set); record a video instead: --video out.mp4"
        )
    import mujoco.viewer

    low, high = command_limits(env)
    keyboard = Keyboard(high, lowest=low)
    view = SceneView(env)
    steps = _FOREVER if seconds is None else round(seconds / CONTROL_DT)
    asked: Sequence[Command] = keyboard if commands is None else commands  # type: ignore[assignment]
    with mujoco.viewer.launch_passive(view.model, view.data, key_callback=keyboard) as window:
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = view.engine.scene.layout.followed_body
        window.cam.distance, window.cam.elevation = 2.6, -18.0
        begun = time.monotonic()
        for step, _ in enumerate(ride_with_resets(policy, env, asked, steps), start=1):
            if not window.is_running():
                break
            with window.lock():
                view.update()
            window.sync()
            time.sleep(max(0.0, begun + step * CONTROL_DT - time.monotonic()))

"""Video of a policy that rides a sequence of commands, rendered without a display."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic
from torchrl_atr._interrupt import signals_held
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.access import achieved_speeds, command_limits, command_owner, deterministic
from torchrl_atr.evaluation.rendering import CHASE, OffscreenRenderer
from torchrl_atr.modules.estimators import with_state

Command = tuple[float, float, float]
DEFAULT_RIDE: tuple[Command, ...] = (
    (0.0, 0.0, 0.0),
    (2.0, 1.0, 0.0),
    (7.0, 2.0, 0.5),
    (12.0, 2.0, -0.5),
    (17.0, 0.0, 0.0),
)
"""Start (s), c_v (m/s) and c_ω (rad/s) of each command."""
_SUFFIXES = {".mp4": "h264", ".gif": "gif"}


@dataclass(frozen=True)
class VideoSummary:
    """Summary of a recorded ride: control steps, frames written, falls of the robot that is shown."""

    steps: int
    frames: int
    falls: int


def command_at(commands: Sequence[Command], time: float) -> tuple[float, float]:
    """Return the command in force at ``time``: the last one that has begun, or the first.

    Example:
        >>> command_at([(0.0, 1.0, 0.0), (2.0, 1.0, 0.5)], 2.5)
        (1.0, 0.5)
    """
    begun = [entry for entry in commands if entry[0] <= time + 1e-9]
    return (begun[-1] if begun else commands[0])[1:]


def record_video(
    policy: TensorDictModuleBase,
    env: EnvBase,
    path: str | Path,
    commands: Sequence[Command] | None = None,
    seconds: float = 20.0,
    fps: float = 25.0,
    camera: str = CHASE,
    size: tuple[int, int] = (640, 480),
) -> VideoSummary:
    """Ride ``commands`` with the policy's deterministic action and write a video of the env's first robot.

    Command, speed and yaw rate are drawn into the picture. A robot that falls is reset, which is counted.
    The file is written atomically. Needs the extra ``video``.

    Args:
        policy: writes the action.
        env: of :func:`~torchrl_atr.envs.make_riding_env`; its first robot is shown. Left unpinned.
        path: ``.mp4`` or ``.gif``.
        commands: (second, c_v in m/s, c_ω in rad/s), in the order of time; None for :data:`DEFAULT_RIDE`, cut to what
            the env's grid draws.
        seconds: length of the video.
        fps: frames per second; rounded to a whole number of control steps between frames.
        camera: ``"chase"`` or the name of a camera of the model.
        size: width and height, pixels.

    Returns:
        Steps, frames and falls.

    Raises:
        InputError: for an unknown suffix or camera, no commands, or commands outside the curriculum's grid.
        ImportError: if mediapy or imageio-ffmpeg is missing.
        DisplayError: if this machine cannot render; names what to install.

    Example:
        >>> record_video(networks.deployed_policy(), env, "ride.mp4")  # doctest: +SKIP
    """
    check_suffix(path)
    if commands is None:
        commands = within(command_limits(env), DEFAULT_RIDE)
    if not commands or not seconds >= CONTROL_DT or not fps > 0:
        raise InputError(
            f"a video of {seconds:g} s with {fps:g} pictures a second and {len(commands)} commands cannot be; give at "
            f"least one command, {CONTROL_DT:g} s and a positive fps"
        )
    every = max(1, round(1.0 / (fps * CONTROL_DT)))
    period, frames, falls = every * CONTROL_DT, 0, 0
    with (
        OffscreenRenderer(env, size, camera) as picture,
        atomic(path) as file,
        video_writer(file, Path(path).suffix, 1.0 / period, size) as writer,
    ):
        for step, (command, fell) in enumerate(
            ride_with_resets(policy, env, commands, round(seconds / CONTROL_DT)), start=1
        ):
            falls += fell
            if step % every == 0:
                names, values = _caption(step * CONTROL_DT, command, achieved_speeds(env)[0].tolist(), falls)
                writer.add_image(picture.render(names, values, period))
                frames += 1
    return VideoSummary(steps=step, frames=frames, falls=falls)


def ride_with_resets(
    policy: TensorDictModuleBase, env: EnvBase, commands: Sequence[Command], steps: int
) -> Iterator[tuple[tuple[float, float], bool]]:
    """Step ``env``, pinned to ``commands``; yield each step's command and whether robot 0 fell in it.

    A robot that falls is reset, so that the next yield shows it standing again.
    """
    env = with_state(env, policy)
    owner, command = command_owner(env), command_at(commands, 0.0)
    owner.pin(command)
    try:
        with deterministic(policy):
            td = env.reset()
        for step in range(steps):
            upcoming = command_at(commands, (step + 1) * CONTROL_DT)
            owner.pin(upcoming)  # observed after this step
            with deterministic(policy):
                stepped, td = env.step_and_maybe_reset(policy(td))
            yield command, bool(stepped["next", "terminated"].reshape(-1)[0])
            command = upcoming
    finally:
        owner.unpin()


def within(limits: tuple[ArrayLike, ArrayLike], commands: Sequence[Command]) -> list[Command]:
    """Return the commands clipped to the lowest and the highest one, (2,) each."""
    pairs = [(begin, np.clip(command, *limits).tolist()) for begin, *command in commands]
    return [(begin, speed, yaw_rate) for begin, (speed, yaw_rate) in pairs]


def _caption(time: float, command: tuple[float, float], speeds: Sequence[float], falls: int) -> tuple[str, str]:
    rows = {
        "time": f"{time:5.1f} s",
        "speed": f"{speeds[0]:+5.2f} m/s   (asked {command[0]:+.2f})",
        "yaw rate": f"{speeds[1]:+5.2f} rad/s (asked {command[1]:+.2f})",
    }
    if falls:
        rows["falls"] = str(falls)
    return "\n".join(rows), "\n".join(rows.values())


def check_suffix(path: str | Path) -> None:
    """Refuse an unknown video format before anything is simulated.

    Raises:
        InputError: for an unknown suffix; names the known ones.
    """
    if Path(path).suffix.lower() not in _SUFFIXES:
        raise InputError(f"cannot write {Path(path).name!r}; choose a name that ends in {' or '.join(_SUFFIXES)}")


@contextmanager
def video_writer(file: Path, suffix: str, fps: float, size: tuple[int, int] = (640, 480)) -> Iterator[Any]:
    """Yield a writer with ``add_image(picture)``; an error or a signal kills its ffmpeg process.

    Args:
        file: to write.
        suffix: ``.mp4`` or ``.gif``.
        fps: frames per second.
        size: width and height, pixels.

    Raises:
        ImportError: if mediapy or imageio-ffmpeg is missing.
    """
    writer = _mediapy().VideoWriter(file, (size[1], size[0]), fps=fps, codec=_SUFFIXES[suffix.lower()])
    try:
        with signals_held():
            writer.__enter__()
        yield writer
    except BaseException:
        if writer._proc is not None:  # closing it would have ffmpeg finish the film first
            writer._proc.kill()
        with suppress(RuntimeError, OSError):  # it has been killed, or its error is this one's cause
            writer.close()
        raise
    writer.close()


def _mediapy() -> Any:
    try:
        import imageio_ffmpeg
        import mediapy
    except ImportError as error:
        raise ImportError("videos need mediapy and imageio-ffmpeg: pip install 'torchrl_atr[video]'") from error
    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    return mediapy

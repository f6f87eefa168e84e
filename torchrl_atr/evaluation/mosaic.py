"""One moving picture of several policies that ride the same commands, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.rendering import OffscreenRenderer
from torchrl_atr.evaluation.video import Command, check_suffix, ride_with_resets, video_writer

Riders = Mapping[str, tuple[TensorDictModuleBase, EnvBase]]
"""Policies and their envs, by the name that stands in the picture."""
COMMANDS: tuple[Command, ...] = ((0.0, 1.5, 0.0), (2.0, 1.5, 0.5))
"""Start (s), c_v (m/s) and c_ω (rad/s) of each command."""


def record_mosaic(
    riders: Riders,
    path: str | Path,
    commands: Sequence[Command] = COMMANDS,
    seconds: float = 5.0,
    fps: float = 4.0,
    columns: int = 4,
    size: tuple[int, int] = (128, 96),
) -> int:
    """Ride the same commands with each policy's deterministic action; write the first robots of all, in a grid.

    Args:
        riders: as in :func:`~torchrl_atr.evaluation.record_video`, each left unpinned.
        path: ``.mp4`` or ``.gif``, written atomically.
        commands: (second, c_v in m/s, c_ω in rad/s), in the order of time.
        seconds: length of the video.
        fps: frames per second; rounded to a whole number of control steps between frames.
        columns: of the grid.
        size: width and height of each picture, pixels.

    Returns:
        The number of frames.

    Raises:
        InputError: for an unknown suffix or camera, no riders, or a length without a frame.
        ImportError: if mediapy or imageio-ffmpeg is missing.
        DisplayError: if this machine cannot render; names what to install.

    Example:
        >>> record_mosaic({"my A1": (networks.deployed_policy(), env)}, "riding.gif")  # doctest: +SKIP
    """
    check_suffix(path)
    every = max(1, round(1.0 / (fps * CONTROL_DT))) if fps > 0 else 0
    steps = round(seconds / CONTROL_DT)
    if not riders or not every or steps < every or columns < 1:
        raise InputError(
            f"a video of {len(riders)} riders in {columns} columns, {seconds:g} s with {fps:g} pictures a second, "
            "cannot be; give at least one rider, one column and one picture"
        )
    period, columns = every * CONTROL_DT, min(columns, len(riders))
    whole = size[0] * columns, size[1] * -(-len(riders) // columns)
    with ExitStack() as stack:
        renderers = {name: stack.enter_context(OffscreenRenderer(env, size)) for name, (_, env) in riders.items()}
        file = stack.enter_context(atomic(path))
        writer = stack.enter_context(video_writer(file, Path(path).suffix, 1.0 / period, whole))
        for step, _ in enumerate(
            zip(*(ride_with_resets(*rider, commands, steps) for rider in riders.values())), start=1
        ):
            if step % every == 0:
                pictures = [_named(renderer.render(dt=period), name) for name, renderer in renderers.items()]
                writer.add_image(tiled(pictures, columns))
    return steps // every


def _named(picture: NDArray[np.uint8], name: str) -> NDArray[np.uint8]:
    image = Image.fromarray(picture)
    ImageDraw.Draw(image).text((4, 2), name, fill="white", stroke_width=1, stroke_fill="black")
    return np.asarray(image)


def tiled(pictures: Sequence[NDArray[np.uint8]], columns: int) -> NDArray[np.uint8]:
    """Return pictures (height, width, 3) row by row in a grid, black where there are none left.

    Example:
        >>> import numpy as np
        >>> tiled([np.ones((2, 3, 3), np.uint8)] * 3, 2).shape
        (4, 6, 3)
    """
    black = [np.zeros_like(pictures[0])] * (-len(pictures) % columns)
    grid = np.stack([*pictures, *black])
    height, width = pictures[0].shape[:2]
    return grid.reshape(-1, columns, height, width, 3).swapaxes(1, 2).reshape(-1, columns * width, 3)

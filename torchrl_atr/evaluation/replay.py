"""Replay of a failed simulation: each recorded control step from its recorded initial state."""

from __future__ import annotations

import inspect
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic
from torchrl_atr._registry import UnknownNameError
from torchrl_atr.envs import Interpretation, QuadrupedEnv, make_task
from torchrl_atr.envs.models.identity import describe, differences, first_few
from torchrl_atr.envs.physics import CONTROL_DT, Simulation
from torchrl_atr.envs.recorder import load_dump
from torchrl_atr.envs.tasks import TASKS
from torchrl_atr.evaluation.rendering import OffscreenRenderer
from torchrl_atr.evaluation.video import check_suffix, video_writer


@dataclass(frozen=True)
class ReplayedStep:
    """Control step of a dump, simulated again.

    Attributes:
        step: number of the step since the start of the episode.
        speed, yaw_rate: achieved after the step, m/s and rad/s; NaN for a task that observes no ``speeds``.
        tilt: the larger of the body's roll and pitch, rad.
        largest_velocity: of all entries of MuJoCo's ``qvel`` after the step, m/s or rad/s.
        largest_action: of the twelve, in units of the action scale.
        diverged: whether the simulation failed in this step.
    """

    step: int
    speed: float
    yaw_rate: float
    tilt: float
    largest_velocity: float
    largest_action: float
    diverged: bool


def replay_failure(path: str | Path, video: str | Path | None = None) -> Generator[ReplayedStep, None, None]:
    """Step through a dump that a :class:`~torchrl_atr.envs.QuadrupedEnv` with a ``dump_dir`` wrote.

    Args:
        path: the dump.
        video: ``.mp4`` or ``.gif``, slowed down ten times; None for no video.

    Yields:
        The recorded steps, oldest first; the last one is the step that failed.

    Raises:
        InputError: if it is no dump, its robot or transporter is unknown or has changed, or the video has another
            suffix.
        DisplayError: if a video is asked for and this machine cannot render.
    """
    dump = load_dump(Path(path))
    if video is not None:
        check_suffix(video)
    env = _make_env(dump, Path(path))
    steps = _steps(env, dump)
    if video is None:
        yield from steps
        return
    with (
        OffscreenRenderer(env) as picture,
        atomic(video) as file,
        video_writer(file, Path(video).suffix, fps=0.1 / CONTROL_DT) as writer,
    ):
        for step in steps:
            text = f"step {step.step}" + ("\nfailed: " + dump["reason"] if step.diverged else "")
            writer.add_image(picture.render(text, dt=10 * CONTROL_DT))
            yield step


def _make_env(dump: dict[str, Any], path: Path) -> QuadrupedEnv:
    scene = dump["scene"]
    try:
        interpretation = Interpretation(**scene["interpretation"])
        if not isinstance(scene["model"], dict):
            raise TypeError("its model is not described")
    except (KeyError, TypeError) as error:
        raise InputError(f"{path} was written by another version ({error}); replay it with that one") from error
    try:
        arguments = {name: scene[name] for name in scene.keys() - {"task", "interpretation", "model", "action_delay"}}
        name = scene.get("task", "riding")
        if "profile" in inspect.signature(TASKS.get(name)).parameters:
            arguments["profile"] = interpretation
        task = make_task(name, **arguments)
        physics = Simulation(action_delay=scene.get("action_delay", 0.0))
        env = QuadrupedEnv(task, num_envs=1, randomization="off", physics=physics, num_threads=1, seed=0)
    except UnknownNameError as error:
        raise InputError(f"{path}: {error}; if a module of yours registers it, give that with --import") from error
    changed = differences(scene["model"], describe(env.scene))
    if changed:
        raise InputError(
            f"{path} is of another {env.scene.robot.name!r} on {env.scene.support.name!r} than the ones known here "
            f"({first_few(changed)}); replay it with those that it was written with"
        )
    return env


def _steps(env: QuadrupedEnv, dump: dict[str, Any]) -> Iterator[ReplayedStep]:
    engine, states, actions = env.engine, dump["states"], dump["actions"]
    idle, extractor = env.runner.get_state(), env.runner.terms.extractor
    command = torch.zeros(1, len(env.task.command), dtype=torch.float32)
    unknown = torch.full((1, 2), float("nan"))
    for index, action in enumerate(actions):
        begun = {name: value[index].unsqueeze(0) for name, value in states.items()}
        env.runner.set_state({**idle, **begun, "x_int": dump["x_int"].unsqueeze(0)})
        # any time but 0: MuJoCo sets it to 0 where it resets a simulation, which is how that is detected
        engine.set_time(torch.tensor([float(dump["step"])], dtype=torch.float64))
        engine.advance()
        speeds = env.runner.observe(command).get("speeds", unknown)[0]
        last = index == len(actions) - 1
        yield ReplayedStep(
            step=dump["step"] - len(actions) + 1 + index,
            speed=float(speeds[0]),
            yaw_rate=float(speeds[1]),
            tilt=float(extractor.read().euler[0, :2].abs().max()),
            largest_velocity=float(engine.qvel[0].abs().max()),
            largest_action=float(action.abs().max()),
            diverged=bool(engine.diverged[0]) or (last and "not finite" in dump["reason"]),
        )

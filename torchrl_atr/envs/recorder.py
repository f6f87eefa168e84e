"""Recorder of the last control steps of every simulation, which are written to a file when one fails."""

from __future__ import annotations

import dataclasses
import os
import uuid
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic
from torchrl_atr.envs.models.files import COPIES
from torchrl_atr.envs.models.identity import describe
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.models.spec_file import is_spec_file
from torchrl_atr.envs.tasks.runner import EpisodeRunner
from torchrl_atr.envs.tasks.task import Task

LENGTH = 25
"""Number of control steps that are kept: half a second, some 60 kB per robot."""
_PARTS = {"scene", "env_id", "step", "reason", "x_int", "states", "actions"}


class FlightRecorder:
    """Recorder of the initial states and actions of the last control steps.

    Args:
        runner: whose robots are recorded.
        scene: robot, transporter and so on by name, to build the scene again; plain values.
        folder: of dumps; created with the first one.
        length: number of control steps that are kept.

    Example:
        See :func:`torchrl_atr.evaluation.replay_failure`.
    """

    def __init__(self, runner: EpisodeRunner, scene: dict[str, Any], folder: Path, length: int = LENGTH) -> None:
        self.runner, self.folder, self.length = runner, folder, length
        portable = {name: _portable(scene[name], folder) for name in COPIES if name in scene}
        self.scene = {**scene, **portable, "action_delay": runner.engine.action_delay}
        self._rings = {name: value.new_zeros(length, *value.shape) for name, value in runner.engine.live_state.items()}
        self._actions = torch.zeros(length, *runner.previous_action.shape, dtype=torch.float32)
        self._noted = 0

    def note(self, action: Tensor) -> None:
        """Record a control step between the runner's ``apply_action`` and the engine's ``advance``.

        Args:
            action: (N, 12).
        """
        slot = self._noted % self.length
        for name, value in self.runner.engine.live_state.items():
            self._rings[name][slot] = value
        self._actions[slot] = action
        self._noted += 1

    def dump(self, row: int, reason: str) -> str:
        """Write the recorded steps of a robot's present episode.

        Args:
            row: which robot.
            reason: what went wrong.

        Returns:
            How to replay it, or why it could not be written: a full disk must not end a run.
        """
        kept = min(self._noted, self.length, int(self.runner.steps[row]))
        slots = [(self._noted - kept + i) % self.length for i in range(kept)]
        path = self.folder / f"diverged-{uuid.uuid4().hex[:8]}-env{row}.pt"
        content = {
            "scene": self.scene,
            "env_id": row,
            "step": int(self.runner.steps[row]),
            "reason": reason,
            "x_int": self.runner.x_int[row].clone(),
            "states": {name: ring[slots, row] for name, ring in self._rings.items()},
            "actions": self._actions[slots, row].clone(),
        }
        try:
            with atomic(path) as file:
                torch.save(content, file)
        except (OSError, RuntimeError) as error:
            return f"; it could not be written to {path} ({error})"
        return f"; see it with: torchrl-atr replay {path}"


def describe_scene(task: Task, scene: Scene) -> dict[str, Any]:
    """Return what :func:`~torchrl_atr.envs.tasks.make_task` needs to build the scene again, as plain values."""
    return {
        "task": task.name,
        **task.arguments,
        "interpretation": dataclasses.asdict(task.interpretation),
        "model": describe(scene),
    }


def _portable(name: str, folder: Path) -> str:
    """Return a file relative to the dumps where both are of one run, so that it can be moved; else absolute."""
    if not is_spec_file(name):
        return name
    path, folder = Path(name).resolve(), folder.resolve()
    return os.path.relpath(path, folder) if path.is_relative_to(folder.parent) else str(path)


def load_dump(path: Path) -> dict[str, Any]:
    """Read a dump.

    Returns:
        Its parts; robot and transporter files in ``scene`` are absolute paths, wherever the dump is now.

    Raises:
        InputError: if it is missing or no dump.
    """
    if not path.is_file():
        raise InputError(f"there is no dump at {path}; a run writes them to its folder diverged/")
    try:
        dump = torch.load(path, map_location="cpu", weights_only=True)
        states, actions = dump["states"], dump["actions"]
        if (
            not dump.keys() >= _PARTS
            or not len(actions)
            or any(len(value) != len(actions) for value in states.values())
        ):
            raise ValueError("parts are missing")
        scene = dump["scene"]
        for name in COPIES & scene.keys():
            scene[name] = str(path.resolve().parent / scene[name]) if is_spec_file(scene[name]) else scene[name]
    except Exception as error:  # unpickling a file of another kind may raise anything
        raise InputError(f"{path} is not a dump of a diverged simulation; give a file of a run's diverged/") from error
    return dump

"""A flight recorder: the last control steps of every simulation, written to a file when one fails."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic
from torchrl_atr.envs.task.core import RidingTask

LENGTH = 50
"""Control steps that are kept: 1 s."""
_LIMIT = 20
"""Dumps that one env writes: the first failures tell the most, and a disk is finite."""


class FlightRecorder:
    """Keeps what the last control steps began from, and what was done in them.

    Args:
        task: whose robots are recorded.
        scene: robot, transporter and so on by name, to build the scene again; plain values.
        folder: where dumps go; made when there is one.
        length: control steps that are kept.

    Example:
        See :func:`torchrl_atr.evaluation.replay`.
    """

    def __init__(self, task: RidingTask, scene: dict[str, Any], folder: Path, length: int = LENGTH) -> None:
        self.task, self.scene, self.folder, self.length = task, scene, folder, length
        self._rings = {name: np.zeros((length, *a.shape)) for name, a in task.engine.live_state.items()}
        self._actions = torch.zeros(length, *task.previous_action.shape)
        self._noted = self.num_dumps = 0

    def note(self, action: Tensor) -> None:
        """Records a control step between the task's ``act`` and the engine's ``advance``.

        Args:
            action: (N, 12).
        """
        slot = self._noted % self.length
        for name, array in self.task.engine.live_state.items():
            self._rings[name][slot] = array
        self._actions[slot] = action
        self._noted += 1

    def dump(self, row: int, reason: str) -> Path | None:
        """Writes what is recorded of a robot's present episode.

        Args:
            row: which robot.
            reason: what went wrong.

        Returns:
            The file, plain tensors that ``torch.load(..., weights_only=True)`` reads; None once there are enough.
        """
        if self.num_dumps >= _LIMIT:
            return None
        self.num_dumps += 1
        kept = min(self._noted, self.length, int(self.task.steps[row]))
        slots = [(self._noted - kept + i) % self.length for i in range(kept)]
        path = self.folder / f"diverged-{os.getpid()}-{self.num_dumps:02d}-env{row}.pt"
        content = {
            "scene": self.scene,
            "env_id": row,
            "step": int(self.task.steps[row]),
            "reason": reason,
            "x_int": self.task.x_int[row].clone(),
            "states": {name: torch.from_numpy(ring[slots, row]) for name, ring in self._rings.items()},
            "actions": self._actions[slots, row].clone(),
        }
        with atomic(path) as file:
            torch.save(content, file)
        return path


def describe_scene(task: RidingTask, robot: Any) -> dict[str, Any]:
    """What :class:`FlightRecorder` needs to build the scene again, as plain values.

    Args:
        task: its transporter and readings.
        robot: as the env was given it; a spec of one's own is named, and must be registered to be replayed.
    """
    return {
        "robot": str(robot) if isinstance(robot, str | Path) else task.scene.robot.name,
        "transporter": task.scene.transporter.name,
        "readings": dataclasses.asdict(task.readings),
    }


def load_dump(path: Path) -> dict[str, Any]:
    """Reads a dump.

    Raises:
        InputError: if it is missing or no dump.
    """
    if not path.is_file():
        raise InputError(f"there is no dump at {path}; a run writes them to its folder diverged/")
    try:
        dump = torch.load(path, map_location="cpu", weights_only=True)
        states, actions = dump["states"], dump["actions"]
        if not len(actions) or any(len(value) != len(actions) for value in states.values()):
            raise ValueError("no steps")
    except Exception as error:  # whatever unpickling a file of another kind comes to
        raise InputError(f"{path} is not a dump of a diverged simulation; give a file of a run's diverged/") from error
    return dump

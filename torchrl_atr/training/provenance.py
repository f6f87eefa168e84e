"""Where a run's numbers come from: the command, the machine, the versions, the frames and minutes it took."""

from __future__ import annotations

import dataclasses
import os
import platform
import shlex
from importlib.metadata import version
from pathlib import Path
from typing import Any

from torchrl_atr.training.config import TrainConfig

_PACKAGES = ("torchrl_atr", "torch", "torchrl", "tensordict", "mujoco", "numpy")


def provenance(config: TrainConfig, frames: int, seconds: float) -> dict[str, Any]:
    """What ``run.json`` holds.

    Args:
        config: of the run.
        frames: robot steps so far.
        seconds: of training so far, wall clock.
    """
    return {
        "command": command_line(config),
        "seed": config.seed,
        "frames": frames,
        "minutes": round(seconds / 60, 2),
        **machine(config.device),
    }


def machine(device: str = "cpu") -> dict[str, Any]:
    """``hardware`` and ``versions`` that a measurement was made with.

    Example:
        >>> machine()["hardware"]["device"]
        'cpu'
    """
    return {
        "hardware": {"processor": _processor(), "cpus": len(os.sched_getaffinity(0)), "device": device},
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}},
    }


def cores(hardware: dict[str, Any]) -> str:
    """How a measurement's machine is written beside its figures.

    Example:
        >>> cores({"cpus": 2, "processor": "Z80", "device": "cpu"})
        '2 cores (Z80)'
    """
    return f"{hardware['cpus']} core{'s' * (hardware['cpus'] > 1)} ({hardware['processor']})"


def command_line(config: TrainConfig) -> str:
    """The command that starts such a run: what differs from the defaults, and the seed.

    Example:
        >>> command_line(TrainConfig(gamma=0.9))
        'torchrl-atr train --robot a1 --transporter single_board --seed 0 --set gamma=0.9'
    """
    parts = [
        f"torchrl-atr train --robot {shlex.quote(config.robot)} --transporter {config.transporter} --seed {config.seed}"
    ]
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name not in ("robot", "transporter", "seed") and value != field.default:
            text = ",".join(map(str, value)) if isinstance(value, tuple) else value
            parts.append(f"--set {field.name}={text}")
    return " ".join(parts)


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()

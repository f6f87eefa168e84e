"""Provenance of a run's figures: the command, the machine, the versions, the frames and minutes it took."""

from __future__ import annotations

import platform
import shlex
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch

import torchrl_atr
from torchrl_atr._cpus import available_cpus
from torchrl_atr._settings import settings
from torchrl_atr.config import TrainConfig, make_config
from torchrl_atr.config.nested import flat, to_text
from torchrl_atr.runs.files import stored_settings

_PACKAGES = ("torchrl_atr", "torch", "torchrl", "tensordict", "mujoco", "numpy")


def provenance(
    config: TrainConfig,
    run: Path,
    model: str | None,
    frames: int,
    seconds: float,
    start: Mapping[str, Any] | None = None,
    parts: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return the content of ``run.json``, from the fingerprint of the ``model``, the frames and seconds so far.

    ``start`` holds ``run`` (the folder), ``config`` and ``provenance`` of the run that this one began from, ``parts``
    the full names of custom factories, which the command cannot name.
    """
    origin = {} if start is None else {"from": {"run": start["run"], **start["provenance"]}}
    return {
        "command": command_line(stored_settings(config, run), start),
        "seed": config.seed,
        "model": model,
        "frames": frames,
        "minutes": round(seconds / 60, 2),
        **machine(config.compute.device),
        **origin,
        **({"parts": dict(parts)} if parts else {}),
    }


def machine(device: str = "cpu") -> dict[str, Any]:
    """Return ``hardware`` and ``versions`` that a measurement was made with; in a clone, with its ``commit``.

    Example:
        >>> machine()["hardware"]["device"]
        'cpu'
    """
    hardware = {"processor": _processor(), "cpus": available_cpus(), "device": device}
    if torch.device(device).type == "cuda":
        hardware["accelerator"] = torch.cuda.get_device_name(device)
    return {
        "hardware": hardware,
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in _PACKAGES},
            **({"commit": commit} if (commit := _commit()) else {}),
        },
    }


def cores(hardware: dict[str, Any]) -> str:
    """Return a measurement's machine as it is written beside its figures.

    Example:
        >>> cores({"cpus": 2, "processor": "Z80", "device": "cpu"})
        '2 cores (Z80)'
        >>> cores({"cpus": 16, "processor": "Z80", "device": "cuda", "accelerator": "GPU X"})
        '16 cores (Z80), GPU X'
    """
    where = f"{hardware['cpus']} core{'s' * (hardware['cpus'] > 1)} ({hardware['processor']})"
    return f"{where}, {hardware['accelerator']}" if "accelerator" in hardware else where


def command_line(config: Mapping[str, Any], start: Mapping[str, Any] | None = None) -> str:
    """Return the command that starts such a run, with settings other than the defaults or the run it began from.

    Example:
        >>> command_line(make_config({"ppo.gamma": 0.9}).to_dict())
        'torchrl-atr train --robot a1 --transporter single_board --seed 0 --ppo.gamma 0.9'
        >>> start = {"run": "runs/ride", "config": make_config({"ppo.gamma": 0.8}).to_dict()}
        >>> command_line(make_config({"ppo.gamma": 0.9, "seed": 1}).to_dict(), start)
        'torchrl-atr train --from runs/ride --seed 1 --ppo.gamma 0.9'
    """
    given, known = flat(config), settings(TrainConfig)
    if start is None:
        defaults = flat(make_config({"task.name": given["task.name"], "preset": given["preset"]}).to_dict())
        named = ["task.robot", "task.transporter", "seed"]
        named += [path for path in ("task.name", "preset") if given[path] != known[path].default]
    else:
        defaults, named = flat(start["config"]), ["seed"]
    parts = [] if start is None else [f"--from {shlex.quote(start['run'])}"]
    for path in [*named, *(path for path in given if path not in named and given[path] != defaults.get(path))]:
        name = (path in known and known[path].alias) or path.replace("_", "-")
        parts.append(f"--{name} {shlex.quote(to_text(given[path]))}")
    return " ".join(["torchrl-atr train", *parts])


@cache  # what the process has imported
def _commit() -> str | None:
    """Return the commit of the clone that the package is in, with ``+`` if files were changed; None outside of one."""
    root = Path(torchrl_atr.__file__).parents[1]
    if not (root / ".git").exists():
        return None

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, encoding="utf-8", check=True)
        return done.stdout.strip()

    try:
        return git("rev-parse", "--short=12", "HEAD") + ("+" if git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.CalledProcessError):
        return None


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8", errors="replace").splitlines() if info.is_file() else []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())

"""Names and types of the options of ``torchrl-atr``: functions that read a word, and say what does not fit."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from torchrl_atr.deploy.manifest import find_policy


def option_name(name: str) -> str:
    """Return the name of an option of ``evaluate`` on the command line."""
    return {"pushes": "--no-pushes"}.get(name, f"--{name.replace('_', '-')}")


def file_path(text: str) -> Path:
    """Return the path of a file or folder that is named."""
    if not text.strip():  # from an unset shell variable; Path("") would be the working directory
        raise argparse.ArgumentTypeError("it is empty; give a path")
    return Path(text)


def run_folder(text: str) -> Path:
    """Return the folder of a run, a bundle, or an installed policy by its name."""
    path = file_path(text)
    if path.is_file():
        raise argparse.ArgumentTypeError(f"{path} is a file; give the folder of a run, such as {path.parent}")
    return find_policy(path)


def number_in(kind: Callable[[str], float], low: float, high: float) -> Callable[[str], float]:
    """Return a parser of numbers in [low, high] for argparse, which names the wrong option."""

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            numbers = "whole number" if kind is int else "number"
            raise argparse.ArgumentTypeError(f"{text!r} does not fit; give a {numbers} in [{low:.10g}, {high:.10g}]")
        return value

    return read


seed = number_in(int, 0, 2**31 - 1)

"""``torch.compile`` for what a control step computes: a few loops instead of hundreds of small operations."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from typing import Any

import torch

from torchrl_atr._errors import InputError


def compiler() -> str | None:
    """The C++ compiler that torch takes for code on a CPU, ``$CXX`` or its default; None if it is not on PATH."""
    return shutil.which(os.environ.get("CXX") or ("clang++" if sys.platform == "darwin" else "g++"))


def compile_step(step: Callable[..., Any], dynamic: bool | None = None) -> Callable[..., Any]:
    """``step``, compiled at its first call, which takes half a minute; what it calls must be traceable by torch.

    torch keeps the result on disk for the next process. A second number of robots is compiled for any number. Other
    robots, transporters, readings or numbers of torch threads are compiled anew, and run eagerly after eight of them,
    with torch's warning.

    Args:
        step: a function of tensors, and of what does not change.
        dynamic: whether it is compiled for any number of robots, or one, at once.

    Raises:
        InputError: if there is no C++ compiler, which torch needs for code on a CPU.
    """
    if compiler() is None:
        raise InputError(
            "compiled=True needs a C++ compiler on PATH, g++ (macOS: clang++) or $CXX, and Python's headers; "
            "install them, or do without"
        )
    return torch.compile(step, dynamic=dynamic)

"""``torch.compile`` for what a control step computes: hundreds of small operations become one kernel."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from typing import Any

import torch

from torchrl_atr._errors import InputError

_COMPILERS = ("g++", "clang++", "c++", "clang")


def compilers() -> list[str]:
    """C++ compilers that torch would find here."""
    return [name for name in (os.environ.get("CXX", ""), *_COMPILERS) if name and shutil.which(name)]


def compile_step(step: Callable[..., Any]) -> Callable[..., Any]:
    """``step``, compiled at its first call, which takes half a minute.

    torch keeps the result on disk for the next process. A second number of robots is compiled for any number.

    Raises:
        InputError: if there is no C++ compiler, which torch needs for code on a CPU.
    """
    if not compilers():
        raise InputError(
            f"compiled=True needs a C++ compiler, and none of {', '.join(_COMPILERS)} is on PATH; install one, or do "
            "without"
        )
    return torch.compile(step, fullgraph=True)

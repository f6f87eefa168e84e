"""``torch.compile`` for what is computed again and again: a few loops instead of hundreds of small operations."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from types import FunctionType, MethodType
from typing import Any

import torch

from torchrl_atr._errors import InputError


def compiler() -> str | None:
    """The C++ compiler that torch takes for code on a CPU, ``$CXX`` or its default; None if it is not on PATH."""
    return shutil.which(os.environ.get("CXX") or ("clang++" if sys.platform == "darwin" else "g++"))


def compile_function(function: Callable[..., Any], dynamic: bool | None = None) -> Callable[..., Any]:
    """``function``, compiled at its first call, which takes half a minute; what it calls must be traceable by torch.

    torch keeps the result on disk for the next process. Other shapes or another number of torch threads are compiled
    anew, and run eagerly after eight of them, with torch's warning.

    Args:
        function: a function or method of tensors, and of what does not change: nobody looks whether it did, which would
            take a third of a millisecond a call.
        dynamic: whether it is compiled for any number of rows, or one, at once.

    Raises:
        InputError: if there is no C++ compiler, which torch needs for code on a CPU.
    """
    if compiler() is None:
        raise InputError(
            "compiled=True needs a C++ compiler on PATH, g++ (macOS: clang++) or $CXX, and Python's headers; "
            "install them, or do without"
        )
    unchecked: dict[str, Any] = {"guard_filter_fn": torch.compiler.keep_portable_guards_unsafe}
    return torch.compile(_own(function), dynamic=dynamic, options=unchecked)


def compile_methods(owner: object, *names: str) -> None:
    """Compiles methods of one object, in place; it cannot be pickled any more. See :func:`compile_function`."""
    for name in names:
        setattr(owner, name, compile_function(getattr(owner, name)))


def _own(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function with code of its own: torch searches what was compiled of one code in order, at every call."""
    if isinstance(function, MethodType):
        return MethodType(_own(function.__func__), function.__self__)
    code, name = function.__code__.replace(), function.__name__
    own = FunctionType(code, function.__globals__, name, function.__defaults__, function.__closure__)
    own.__kwdefaults__ = function.__kwdefaults__
    return own

"""Compilation of repeated computations: ``torch.compile`` on a CPU, captured CUDA graphs on a GPU."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from types import FunctionType, MethodType
from typing import Any

import torch
from tensordict import TensorDictBase
from torch.utils._pytree import tree_leaves

from torchrl_atr._errors import InputError, first_line


def compiler() -> str | None:
    """Return the C++ compiler that torch uses for a CPU, ``$CXX`` or its default; None if it is not on PATH."""
    return shutil.which(os.environ.get("CXX") or ("clang++" if sys.platform == "darwin" else "g++"))


def compile_function(function: Callable[..., Any], any_rows: bool = False, short: bool = False) -> Callable[..., Any]:
    """Return ``function`` compiled at its first call, in half a minute; torch must be able to trace what it calls.

    torch keeps the result on disk for the next process. Other shapes or another number of torch threads are compiled
    anew, and run eagerly after eight of them, with torch's warning.

    Args:
        function: a function or method of tensors and constants; changes of the latter are not checked, which would take
            a third of a millisecond a call.
        any_rows: whether it is compiled at once for any number of rows, the first dimension of its tensors, above one.
            torch's ``dynamic=True`` lets all other sizes and the bounds of slices vary too, and takes twice as long.
        short: whether loops that would give each thread less than 8,192 elements, not 512, run in one: for code
            that runs beside physics, whose threads take turns with torch's.

    Raises:
        InputError: if there is no C++ compiler, which torch needs for code on a CPU.
    """
    if compiler() is None:
        raise InputError(
            "compiled=True needs a C++ compiler on PATH, g++ (macOS: clang++) or $CXX, and Python's headers; "
            "install them, or do without"
        )
    options: dict[str, Any] = {
        "guard_filter_fn": torch.compiler.keep_portable_guards_unsafe,
        "size_asserts": False,  # guards have checked the shapes
        **({"cpp.min_chunk_size": 8192} if short else {}),
    }
    compiled = torch.compile(_own(function), options=options)
    return _with_any_rows(compiled) if any_rows else compiled


def _with_any_rows(compiled: Callable[..., Any]) -> Callable[..., Any]:
    known = False

    def call(*arguments: Any) -> Any:
        nonlocal known
        if not known:
            for value in tree_leaves(arguments):
                torch._dynamo.maybe_mark_dynamic(value, 0)
            known = True
        return compiled(*arguments)

    return call


def compile_methods(owner: object, *names: str, **how: bool) -> None:
    """Compile methods of one object, in place; pickling has to leave them out. See :func:`compile_function`."""
    for name in names:
        setattr(owner, name, compile_function(getattr(owner, name), **how))


class CudaGraph:
    """Function of a TensorDict as one CUDA graph: launched as a whole, not operation by operation.

    The first calls, and those with another number of rows than was captured, run as they are. tensordict's
    ``CudaGraphModule`` waits for the GPU at every call; this does not.

    Args:
        function: takes a TensorDict on a GPU and returns one; may change parameters and optimiser states in place. It
            must not wait for the GPU, nor read what changes outside it and is no tensor.
        warmup: calls before it is captured, for what is made when first needed.

    Raises:
        InputError: at the call at which it is captured, if it cannot be.
    """

    def __init__(self, function: Callable[[TensorDictBase], TensorDictBase], warmup: int = 3) -> None:
        self.function, self.warmup = function, warmup
        self._captured: tuple[torch.cuda.CUDAGraph, TensorDictBase, TensorDictBase] | None = None
        self._stream = torch.cuda.Stream()

    def __call__(self, inputs: TensorDictBase) -> TensorDictBase:
        """Return the function's result in new tensors."""
        if self.warmup > 0:
            self.warmup -= 1
            return self._beside(inputs)
        graph, read, written = self._captured = self._captured or self._capture(inputs)
        if inputs.shape != read.shape:
            return self.function(inputs)
        read.update_(inputs)
        graph.replay()
        return written.clone()

    def _beside(self, inputs: TensorDictBase) -> TensorDictBase:
        """Run on another stream, as torch advises: what autograd keeps of the main one could not be captured."""
        main = torch.cuda.current_stream()
        self._stream.wait_stream(main)
        with torch.cuda.stream(self._stream):
            outputs = self.function(inputs)
        main.wait_stream(self._stream)
        return outputs

    def _capture(self, inputs: TensorDictBase) -> tuple[torch.cuda.CUDAGraph, TensorDictBase, TensorDictBase]:
        graph, read = torch.cuda.CUDAGraph(), inputs.clone()
        generator = torch.cuda.default_generators[torch.cuda.current_device()]
        state = generator.clone_state()
        try:
            with torch.cuda.graph(graph):  # nothing is computed yet
                written = self.function(read)
        except RuntimeError as error:
            generator.graphsafe_set_state(state)  # a capture that failed leaves it unable to draw
            raise InputError(
                f"compiled=True: this cannot become a CUDA graph ({first_line(error)}); a module in it waits for the "
                "GPU, as .item() and an if on a tensor do, or sends data there: change that, or do without compiled"
            ) from error
        return graph, read, written


def _own(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function with a code object of its own: torch searches all that was compiled of one at every call."""
    if isinstance(function, MethodType):
        return MethodType(_own(function.__func__), function.__self__)
    code, name = function.__code__.replace(), function.__name__
    own = FunctionType(code, function.__globals__, name, function.__defaults__, function.__closure__)
    own.__kwdefaults__ = function.__kwdefaults__
    return own

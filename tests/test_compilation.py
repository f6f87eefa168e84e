"""Functions that torch compiles keep out of each other's way; what a CUDA graph does is what its function does."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr._compilation import CudaGraph, compile_function, compiler
from torchrl_atr._errors import InputError

on_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device; torch finds none here")


@torch._dynamo.config.patch(recompile_limit=1, fail_on_recompile_limit_hit=True)
@pytest.mark.skipif(compiler() is None, reason="no C++ compiler on PATH")
def test_what_is_compiled_for_one_object_is_not_searched_by_another():
    """torch stops compiling one code after ``recompile_limit`` times, and tries what it has in order at every call."""

    class Env:
        def __init__(self, number):
            self.number = number

        def step(self, x):
            return x + self.number

    steps = [compile_function(Env(number).step) for number in (1, 2, 3)]
    assert [step(torch.zeros(())).item() for step in steps] == [1, 2, 3]


@pytest.mark.skipif(compiler() is None, reason="no C++ compiler on PATH")
def test_any_number_of_rows_is_compiled_once_and_other_sizes_stay_fixed():
    torch._dynamo.utils.counters.clear()
    double = compile_function(lambda pair, offset: [2 * part[:, 1:] + offset for part in pair], any_rows=True)
    for rows in (6, 3, 2, 5):
        first, second = torch.rand(rows, 3), torch.rand(rows, 2)
        got = double((first, second), torch.ones(rows, 1))
        torch.testing.assert_close(got, [2 * first[:, 1:] + 1, 2 * second[:, 1:] + 1])
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] == 1


@on_gpu
def test_a_captured_step_counts_on_with_any_number_of_rows_and_gives_tensors_of_its_own():
    total, calls, given = torch.zeros((), device="cuda"), [], []

    def add(inputs):
        calls.append(len(inputs))
        total.add_(inputs["x"].sum())
        return TensorDict(total=total.clone())

    graph = CudaGraph(add, warmup=2)
    for rows in (3, 3, 3, 3, 3, 2):
        given.append(graph(TensorDict({"x": torch.ones(rows, device="cuda")}, [rows]))["total"])
    assert [value.item() for value in given] == [3, 6, 9, 12, 15, 17]
    assert calls == [3, 3, 3, 2]  # two to warm up, the capture, and the odd one; the rest are replayed


@on_gpu
def test_what_waits_for_the_gpu_is_named_as_the_reason():
    graph = CudaGraph(lambda inputs: inputs if inputs["x"].sum().item() > 0 else -inputs, warmup=1)
    ones = TensorDict({"x": torch.ones(2, device="cuda")}, [2])
    assert graph(ones)["x"].tolist() == [1, 1]
    with pytest.raises(InputError, match=r"cannot become a CUDA graph .* do without compiled"):
        graph(ones)
    assert (ones["x"] + 1).tolist() == [2, 2]
    assert torch.rand(2, device="cuda").isfinite().all()  # random numbers can still be drawn

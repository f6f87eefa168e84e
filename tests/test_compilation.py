"""Functions that torch compiles keep out of each other's way."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr._compilation import compile_function, compiler


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

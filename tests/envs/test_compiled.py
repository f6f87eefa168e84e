"""A compiled step computes what the eager one does."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from torchrl_atr._errors import InputError
from torchrl_atr.envs import RidingEnv, make_riding_env
from torchrl_atr.envs.task import compilation

with_compiler = pytest.mark.skipif(not compilation.compilers(), reason="no C++ compiler on PATH")


@with_compiler
def test_a_compiled_step_is_the_eager_one_to_rounding():
    torch.manual_seed(0)
    actions = 0.3 * torch.randn(60, 16, 12)
    rides = []
    for compiled in (False, True):
        env = make_riding_env(num_envs=16, num_threads=1, seed=0, compiled=compiled, max_steps=25, window=10)
        td, steps = env.reset(), []
        for action in actions:
            step, td = env.step_and_maybe_reset(td.set("action", action))
            steps.append(step)
        rides.append(torch.stack(steps, 1))
    eager, compiled = rides
    assert eager["next", "done"].any()
    assert sorted(map(str, eager.keys(True, True))) == sorted(map(str, compiled.keys(True, True)))
    for key, value in eager.items(True, True):
        torch.testing.assert_close(
            compiled[key], value, atol=2e-3, rtol=2e-4, msg=lambda text, key=key: f"{key}: {text}"
        )


@with_compiler
def test_a_compiled_env_keeps_its_specs():
    check_env_specs(RidingEnv(num_envs=16, num_threads=1, seed=0, compiled=True))


def test_without_a_compiler_the_error_says_so(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(InputError, match=r"compiled=True needs a C\+\+ compiler"):
        RidingEnv(num_envs=2, compiled=True)

"""A compiled step computes what the eager one does."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from torchrl_atr._compilation import compiler
from torchrl_atr._errors import InputError
from torchrl_atr.envs import RidingEnv, make_env
from torchrl_atr.envs.tasks import make_task

with_compiler = pytest.mark.skipif(compiler() is None, reason="no C++ compiler on PATH")


def ride(compiled: bool, name: str = "riding", **options):
    torch.manual_seed(0)
    task = make_task(name, **options)
    env = make_env(task, num_envs=16, num_threads=1, seed=0, compiled=compiled, max_steps=25, window=10)
    td, steps = env.reset(), []
    for action in 0.3 * torch.randn(60, 16, 12):
        step, td = env.step_and_maybe_reset(td.set("action", action))
        steps.append(step)
    return torch.stack(steps, 1)


@with_compiler
@pytest.mark.parametrize(
    "options",
    [{}, {"profile": "literal"}, {"transporter": "two_board", "profile": "legged_gym"}, {"name": "walking"}],
    ids=["default", "literal", "two boards, legged_gym", "walking"],
)
def test_a_compiled_step_is_the_eager_one_to_rounding(request, options):
    if options:  # the default one alone is built
        request.getfixturevalue("traced")
    torch._dynamo.utils.counters.clear()
    eager, compiled = ride(False, **options), ride(True, **options)
    assert not torch._dynamo.utils.counters["graph_break"]
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] > 0
    assert eager["next", "done"].any()
    assert sorted(map(str, eager.keys(True, True))) == sorted(map(str, compiled.keys(True, True)))
    for key, value in eager.items(True, True):
        torch.testing.assert_close(
            compiled[key], value, atol=1e-4, rtol=1e-4, msg=lambda text, key=key: f"{key}, {text}"
        )


@with_compiler
@pytest.mark.usefixtures("traced")
def test_a_compiled_env_keeps_its_specs_and_contains_what_is_no_number():
    env = RidingEnv(num_envs=16, num_threads=1, seed=0, compiled=True)
    check_env_specs(env)
    td = env.reset()
    env.engine.qvel[3] = float("nan")
    after = env.step(td.set("action", torch.zeros(16, 12)))["next"]
    assert after["terminated"].squeeze(-1).nonzero().tolist() == [[3]]
    assert all(value.isfinite().all() for value in after.values(True, True))
    assert env.num_diverged == 1


def test_without_a_compiler_the_error_says_so(monkeypatch):
    monkeypatch.setenv("CXX", "/nowhere/c++")
    with pytest.raises(InputError, match=r"compiled=True needs a C\+\+ compiler"):
        RidingEnv(num_envs=2, compiled=True)

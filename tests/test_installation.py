"""What an installation must bring, and what it may lack."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, PrioritizedSampler, TensorDictReplayBuffer


def test_torchrls_compiled_extension_loads():
    sampler = PrioritizedSampler(10, alpha=0.6, beta=0.4)  # needs the extension
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(10), sampler=sampler, batch_size=4)
    buffer.extend(TensorDict(a=torch.arange(10), batch_size=[10]))
    assert buffer.sample()["a"].shape == (4,)


def run_without_dm_control(code: str) -> str:
    code = f"import sys; sys.modules['dm_control'] = None\n{code}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stderr


def test_the_batched_env_needs_no_dm_control():
    code = "from torchrl_atr.envs import make_riding_env; make_riding_env(num_envs=2, num_threads=1).rollout(2)"
    assert run_without_dm_control(code) == ""


@pytest.mark.parametrize(
    "code",
    [
        "import torchrl_atr.envs.suite",
        "from torchrl_atr.envs import RidingEnv as E; E(physics='dm_control', num_envs=1)",
    ],
)
def test_what_needs_dm_control_says_how_to_install_it(code):
    last = run_without_dm_control(code).splitlines()[-1]
    assert last.endswith("MissingPackageError: dm_control is not installed; pip install 'torchrl_atr[suite]'")

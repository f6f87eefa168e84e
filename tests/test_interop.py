"""The parts alone: our env under stock TorchRL PPO, and a light import."""

from __future__ import annotations

import subprocess
import sys

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.modules import MLP, IndependentNormal, NormalParamExtractor, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from torchrl_atr.envs import make_riding_env


def test_our_env_trains_with_stock_clip_ppo():
    torch.manual_seed(0)
    env = make_riding_env(num_envs=8, num_threads=1, seed=0)
    sizes = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    net = nn.Sequential(MLP(sizes[0], 2 * sizes[1], num_cells=[32]), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(MLP(sizes[0], 1, num_cells=[32]), in_keys=["observation"])
    loss, advantage = ClipPPOLoss(actor, critic), GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    optimizer = torch.optim.Adam(loss.parameters(), 1e-3)
    critic_losses = []
    collector = Collector(
        env, actor, frames_per_batch=8 * 8, total_frames=2 * 8 * 8, auto_register_policy_transforms=False
    )
    for batch in collector:
        with torch.no_grad():
            batch = advantage(batch).reshape(-1)
        for _ in range(20):
            terms = loss(batch)
            optimizer.zero_grad()
            sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
            optimizer.step()
            critic_losses.append(float(terms["loss_critic"].detach()))
    collector.shutdown(close_env=False)
    assert critic_losses[19] < 0.9 * critic_losses[0]
    assert critic_losses[-1] < 0.9 * critic_losses[20]


def test_importing_the_package_is_light():
    code = "import sys, torchrl_atr; print(sorted({'torch', 'mujoco', 'dm_control', 'matplotlib'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_the_command_line_does_not_wait_for_torch():
    code = "import sys, torchrl_atr.cli.commands; print(sorted({'torch', 'mujoco', 'matplotlib'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout.strip() == "[]"


def test_the_training_path_imports_no_dm_control_nor_matplotlib():
    code = "import sys, torchrl_atr.training; print(sorted({'dm_control', 'matplotlib'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_lower_rooms_do_not_import_the_env():
    code = (
        "import sys, torchrl_atr.modules, torchrl_atr.objectives; "
        "print([m for m in sys.modules if m.startswith('torchrl_atr.envs')])"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"

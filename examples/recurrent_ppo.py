"""Example of our riding env with a recurrent policy in TorchRL's own PPO, in place of history and estimators.

    python examples/recurrent_ppo.py

TorchRL carries the hidden state: ``InitTracker`` marks where episodes begin, the primer of ``GRUModule`` declares the
state, and the loss runs over whole sequences, (N, T), with ``set_recurrent_mode(True)``.
"""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import InitTracker
from torchrl.modules import (
    MLP,
    GRUModule,
    IndependentNormal,
    NormalParamExtractor,
    ProbabilisticActor,
    ValueOperator,
    set_recurrent_mode,
)
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from torchrl_atr.envs import make_riding_env

PRIVILEGED = [("privileged", "intrinsic"), ("privileged", "extrinsic")]


def main(
    iterations: int = 20, num_envs: int = 64, steps: int = 24, features: int = 64
) -> tuple[list[float], list[float]]:
    """Train, print one line per iteration; return mean rewards, and largest importance ratios of first minibatches."""
    torch.manual_seed(0)
    env = make_riding_env("a1", "single_board", num_envs=num_envs, seed=0, compact_storage=True)
    observed, actions = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    memory = GRUModule(features, features, in_keys=["embedding", "h", "is_init"], out_keys=["features", ("next", "h")])
    head = nn.Sequential(MLP(features, 2 * actions, num_cells=[features]), NormalParamExtractor("biased_softplus_0.3"))
    actor = ProbabilisticActor(
        TensorDictSequential(
            TensorDictModule(MLP(observed, features, num_cells=[]), in_keys=["observation"], out_keys=["embedding"]),
            memory,
            TensorDictModule(head, in_keys=["features"], out_keys=["loc", "scale"]),
        ),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    for transform in (InitTracker(), memory.make_tensordict_primer()):
        env.append_transform(transform)
    inputs = observed + sum(env.observation_spec[key].shape[-1] for key in PRIVILEGED)
    critic = ValueOperator(MLP(inputs, 1, num_cells=[128, 128]), in_keys=["observation", *PRIVILEGED])
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.0, normalize_advantage=True)
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
    collector = Collector(
        env,
        actor,
        frames_per_batch=num_envs * steps,
        total_frames=num_envs * steps * iterations,
        auto_register_policy_transforms=False,  # they are in the env already
    )
    rewards, ratios = [], []
    for iteration, batch in enumerate(collector):
        with torch.no_grad():
            batch = advantage(batch)
        with set_recurrent_mode(True):
            for _ in range(3):
                for minibatch in batch[torch.randperm(num_envs)].chunk(4):  # robots are shuffled, their steps are not
                    terms = loss(minibatch)
                    optimizer.zero_grad()
                    sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
                    nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                    optimizer.step()
                    if len(ratios) == iteration:
                        ratios.append(float(terms["max_ratio"]))
        rewards.append(float(batch["next", "reward"].mean()))
        print(f"{iteration:4d}  reward {rewards[-1]:+.3f}  KL {float(terms['kl_approx']):.4f}")
    collector.shutdown(close_env=False)
    return rewards, ratios


if __name__ == "__main__":
    main()

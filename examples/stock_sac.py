"""Example of our riding env with TorchRL's own soft actor-critic: no networks, loss or trainer of ours.

    python examples/stock_sac.py

The actor reads ``observation``; both critics also read what is privileged, as an asymmetric critic may.
"""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MLP, NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate

from torchrl_atr.envs import make_riding_env

PRIVILEGED = [("privileged", "intrinsic"), ("privileged", "extrinsic")]


def main(frames: int = 20_000, num_envs: int = 64, batch: int = 256, cells: int = 128) -> list[float]:
    """Train off-policy, print a line every ten batches, and return the critics' losses."""
    torch.manual_seed(0)
    env = make_riding_env("a1", "single_board", num_envs=num_envs, seed=0)
    spec, observed = env.action_spec_unbatched, env.observation_spec["observation"].shape[-1]
    net = nn.Sequential(MLP(observed, 2 * spec.shape[-1], num_cells=[cells, cells]), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        spec=spec,  # bounded: what it means is in QuadrupedEnv's docstring
        distribution_class=TanhNormal,
        distribution_kwargs={"low": spec.space.low, "high": spec.space.high, "tanh_loc": False},
    )
    inputs = observed + spec.shape[-1] + sum(env.observation_spec[key].shape[-1] for key in PRIVILEGED)
    critic = ValueOperator(MLP(inputs, 1, num_cells=[cells, cells]), in_keys=["observation", "action", *PRIVILEGED])
    loss = SACLoss(actor, critic, action_spec=spec)
    loss.make_value_estimator(gamma=0.99)
    targets = SoftUpdate(loss, tau=0.005)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(frames), batch_size=batch)
    collector = Collector(
        env,
        actor,
        frames_per_batch=num_envs * 4,
        total_frames=frames,
        init_random_frames=num_envs * 16,
        auto_register_policy_transforms=False,
    )
    losses = []
    for count, data in enumerate(collector):
        buffer.extend(data.exclude("history", ("next", "history")).reshape(-1))  # most of the memory, and not read
        for _ in range(4):
            terms = loss(buffer.sample())
            optimizer.zero_grad()
            sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
            optimizer.step()
            targets.step()
        losses.append(float(terms["loss_qvalue"].detach()))
        if count % 10 == 0:
            reward = float(data["next", "reward"].mean())
            print(f"{count:4d}  reward {reward:+.3f}  critic {losses[-1]:.3f}  alpha {float(terms['alpha']):.3f}")
    collector.shutdown(close_env=False)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        ride = env.rollout(50, actor)
    print(f"one second by the mean action: reward {float(ride['next', 'reward'].mean()):+.3f} per step")
    return losses


if __name__ == "__main__":
    main()

"""Example of the whole RL-ATR training loop without the trainer: env, networks, loss, GAE and optimisers.

    python examples/raw_loop.py --iterations 50

Copy it and replace any part: all are TorchRL components that share only TensorDict keys.
"""

from __future__ import annotations

import argparse

import torch
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, SamplerWithoutReplacement, TensorDictReplayBuffer
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives.value import GAE

from torchrl_atr.envs import make_riding_env
from torchrl_atr.modules import make_networks
from torchrl_atr.objectives import ROAClipPPOLoss


def main(iterations: int = 50, num_envs: int = 256, steps: int = 24, seed: int = 0) -> list[float]:
    """Train, print one line per iteration, and return the mean reward of each."""
    torch.manual_seed(seed)
    env = make_riding_env("a1", "single_board", num_envs=num_envs, seed=seed, compact_storage=True)
    inputs = {"estimator_inputs": ["dead_reckoned_velocity"], "critic_inputs": [("privileged", "tracking_forecast")]}
    networks = make_networks(env.observation_spec, env.action_spec, estimator="cnn_gru", **inputs)
    # initial means and scales from a random rollout with actions as large as an untrained policy's
    noise = env.rollout(steps, lambda tensordict: tensordict.set("action", torch.randn(env.action_spec.shape)))
    networks.update_normalizers(noise)

    # "privileged": the actor reads the encoder's latent and the true extrinsic state, as in the paper's training phase
    collector = Collector(
        env,
        networks.rollout_policy("privileged"),
        frames_per_batch=num_envs * steps,
        total_frames=num_envs * steps * iterations,
        auto_register_policy_transforms=False,
    )
    loss = ROAClipPPOLoss(
        networks.training_actor("privileged"),
        networks.critic_module,
        networks.encoder_module,
        networks.intrinsic_estimator_module,
        networks.extrinsic_estimator_module,
        extrinsic_scale=networks.ext_norm,
        entropy_coeff=0.0,
        critic_coeff=0.01,
        loss_critic_type="l2",
    )
    advantage = GAE(gamma=0.995, lmbda=0.95, value_network=networks.critic_module, average_gae=True)
    policy = torch.optim.Adam(networks.policy_parameters(), lr=3e-4)
    estimators = torch.optim.Adam(networks.estimator_parameters(), lr=1e-3)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(num_envs * steps),
        sampler=SamplerWithoutReplacement(),
        batch_size=num_envs * steps // 4,
    )

    rewards = []
    for iteration, batch in enumerate(collector):
        with torch.no_grad():
            batch = advantage(batch)
        buffer.extend(batch.reshape(-1))
        for epoch in range(3):
            for minibatch in buffer:
                terms = loss.policy_loss(minibatch)
                optimise(policy, terms)
                if epoch == 0:  # the estimators learn from the same batch, with their own optimiser
                    errors = loss.adaptation_loss(minibatch)
                    optimise(estimators, errors)
        networks.update_normalizers(batch)
        rewards.append(float(batch["next", "reward"].mean()))
        print(
            f"{iteration:4d}  reward {rewards[-1]:+.3f}  KL {float(terms['kl_approx']):.4f}  "
            f"extrinsic error {float(errors['extrinsic_error']):.2f} std"
        )
    collector.shutdown(close_env=False)

    with set_exploration_type(ExplorationType.DETERMINISTIC):  # as on a real robot: no privileged input
        ride = env.rollout(50, networks.deployed_policy())
    print(f"deployed for one second: reward {float(ride['next', 'reward'].mean()):+.3f} per step")
    return rewards


def optimise(optimizer: torch.optim.Optimizer, terms) -> None:
    """Take one optimiser step on the sum of the ``loss_*`` entries."""
    optimizer.zero_grad()
    sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
    torch.nn.utils.clip_grad_norm_([p for group in optimizer.param_groups for p in group["params"]], 1.0)
    optimizer.step()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=50)
    parser.add_argument("--num-envs", type=int, default=256)
    main(**vars(parser.parse_args()))

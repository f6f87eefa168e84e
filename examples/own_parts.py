"""Example of training with custom parts: env, networks, callback and logger; run folder, resume, evaluation as usual.

    python examples/own_parts.py runs/own

docs/own_parts.md lists what each part needs. Parts that are not given are the default ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.record.loggers import CSVLogger

from torchrl_atr.envs import RIDING_REWARDS, RewardTerm, make_riding_env
from torchrl_atr.evaluation import evaluate_tracking
from torchrl_atr.modules import ROANetworks, make_networks
from torchrl_atr.training import Callback, Trainer, load_checkpoint, load_run, make_config


def haste(context) -> torch.Tensor:
    """Compute the square of the forward speed, m²/s², (N,)."""
    return context.state.speeds[:, 0].square()


def make_env(num_envs: int, seed: int, num_threads: int | None = None, **more: Any) -> EnvBase:
    """Return a Go1 on two boards with a custom reward term; any EnvBase with the keys of docs/own_parts.md works."""
    rewards = {**RIDING_REWARDS, "haste": RewardTerm(haste, -0.05)}
    return make_riding_env("go1", "two_board", num_envs, seed=seed, num_threads=num_threads, rewards=rewards, **more)


def make_small_networks(env: EnvBase) -> ROANetworks:
    """Return smaller networks than Table I's."""
    return make_networks(
        env.observation_spec, env.action_spec, estimator="mlp", actor_cells=(64, 32), critic_cells=(64, 32)
    )


class ScaledRewards(Callback):
    """Callback that divides rewards by their running standard deviation, which is saved and restored."""

    def __init__(self) -> None:
        self.variance = 1.0

    def on_batch(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the batch to learn from, (N, T)."""
        reward = batch["next", "reward"]
        self.variance += 0.1 * (float(reward.var()) - self.variance)
        return batch.set(("next", "reward"), reward / self.variance**0.5)

    def on_iteration(self, metrics: dict[str, float]) -> None:
        """Add a metric, which is logged with the others."""
        metrics["reward_std"] = self.variance**0.5

    def state_dict(self) -> dict[str, Any]:
        """Return the state for checkpoints."""
        return {"variance": self.variance}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the state of a checkpoint."""
        self.variance = state["variance"]


def main(run: Path, iterations: int = 2, more: int = 1, num_envs: int = 8) -> Trainer:
    """Train for some iterations, resume for some more as another process would, and evaluate."""
    small = {"env.num_envs": num_envs, "ppo.rollout_steps": 8, "ppo.minibatches": 2}
    trainer = None
    for total in (iterations, iterations + more):
        trainer = Trainer(
            make_config({**small, "total_frames": total * num_envs * 8}),
            run,
            load_checkpoint(run) if trainer is not None else None,
            make_env=make_env,
            make_networks=make_small_networks,
            logger=CSVLogger("scalars", log_dir=str(run)),
            callbacks=[ScaledRewards()],
        )
        trainer.train()
    _, env, networks, _ = load_run(run, make_env=make_env, make_networks=make_small_networks, num_envs=1)
    env.close()
    result = evaluate_tracking(networks.deployed_policy(), make_env, ([0.0, 1.0], [0.0]), 2, seconds=0.4, settle=0.2)
    print(f"{trainer.iteration} iterations; {result.survived.mean():.0%} of the robots are up after 0.4 s")
    return trainer


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    main(parser.parse_args().run)

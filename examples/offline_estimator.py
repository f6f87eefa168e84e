"""Example of an estimator trained offline, from a replay buffer on disk: no env, no policy.

    python examples/offline_estimator.py record runs/rides     # rides of random actions, written to disk
    python examples/offline_estimator.py train runs/rides      # another process, later, as often as you like

The estimator infers contacts, velocities and pose on the board from what the robot sensed in the last 0.2 s. Data of
your own need a history (N, H, D) and the entry to estimate (N, E), under any names.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torchrl.data import LazyMemmapStorage, TensorDictReplayBuffer

from torchrl_atr.envs import make_riding_env
from torchrl_atr.modules import EstimatorModule, make_estimator
from torchrl_atr.objectives import regression

TARGET, INPUTS = ("privileged", "extrinsic"), ["dead_reckoned_velocity"]


def replay_buffer(size: int) -> TensorDictReplayBuffer:
    """Return an empty buffer whose steps are memory-mapped files; one that loads needs the size of one that dumped."""
    return TensorDictReplayBuffer(storage=LazyMemmapStorage(size), batch_size=256)


def record(folder: Path, num_envs: int = 64, steps: int = 200) -> None:
    """Write rides of random actions to a folder, every step with what the estimator reads and its target."""
    torch.manual_seed(0)
    env = make_riding_env("a1", "single_board", num_envs=num_envs, sensors="realistic", seed=0)
    rides = env.rollout(
        steps,
        lambda tensordict: tensordict.set("action", 0.3 * torch.randn(env.action_spec.shape)),
        break_when_any_done=False,
    )
    buffer = replay_buffer(rides.numel())
    buffer.extend(rides.select("history", *INPUTS, TARGET).reshape(-1))
    buffer.dumps(folder)
    print(f"{len(buffer)} steps in {folder}")


def train(
    folder: Path, name: str = "cnn_gru", epochs: int = 5, size: int = 64 * 200, held_out: int = 2000
) -> tuple[EstimatorModule, list[float]]:
    """Train on all but the last steps; return the estimator, and R² on these before training and after each epoch."""
    torch.manual_seed(0)
    stored = replay_buffer(size)
    stored.loads(folder)
    data = stored[:]  # still on disk
    fitting, test = data[:-held_out], data[-held_out:]
    estimator = make_estimator(fitting, name, target=TARGET, inputs=INPUTS)
    optimizer = torch.optim.Adam(estimator.parameters(), lr=1e-3)
    written, scale = estimator.spec.estimate_keys[0], estimator.spec.scale_keys[0]
    explained = []
    for epoch in range(epochs + 1):
        with torch.no_grad():
            error, truth = estimator(test.clone())[written] - test[TARGET], test[TARGET]
        explained.append(float(1 - error.square().mean() / (truth - truth.mean(0)).square().mean()))
        print(f"epoch {epoch}: R² {explained[-1]:+.3f} on rides that it has not seen")
        if epoch == epochs:
            break
        for steps in torch.randperm(len(fitting)).split(256):
            batch = fitting[steps]
            estimate, own_losses = estimator.estimate_and_losses(batch)  # some estimators add losses of their own
            unit = estimator.output_norm.std
            loss, *_ = regression(estimate[written], batch[TARGET], unit, estimate.get(scale, None))
            optimizer.zero_grad()
            sum([loss, *own_losses.values()]).mean().backward()
            optimizer.step()
    return estimator, explained


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["record", "train"])
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    {"record": record, "train": train}[arguments.what](arguments.folder)

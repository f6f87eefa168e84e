"""Example of the ROA loss and an estimator on envs that are not ours: a cheetah of hidden mass and friction.

    pip install 'torchrl_atr[gymnasium]' && python examples/hidden_parameters.py gymnasium   # HalfCheetah-v5
    pip install 'torchrl_atr[suite]' && python examples/hidden_parameters.py dm_control      # cheetah, run

The cheetah senses its pitch, its joint angles and its last action. Mass and friction are drawn at every reset: the
encoder reads them, the intrinsic estimator infers their latent, and the extrinsic estimator the velocity of the torso.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

import mujoco
import torch
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import Composite, Unbounded
from torchrl.envs import DMControlEnv, DoubleToFloat, EnvBase, GymEnv, SerialEnv, StepCounter, Transform, TransformedEnv

from torchrl_atr.envs.transforms import ObservationHistory
from torchrl_atr.modules import ROANetworks, make_networks
from torchrl_atr.objectives import ROAClipPPOLoss

LIBRARIES = {"gymnasium": partial(GymEnv, "HalfCheetah-v5"), "dm_control": partial(DMControlEnv, "cheetah", "run")}
SIZES = {"observation": 13, ("privileged", "intrinsic"): 2, ("privileged", "extrinsic"): 3}


def simulation(env: Any) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return model and data of a MuJoCo env of dm_control or Gymnasium."""
    if hasattr(env, "physics"):
        return env.physics.model.ptr, env.physics.data.ptr
    return env.unwrapped.model, env.unwrapped.data


class HiddenParameters(Transform):
    """Transform that draws mass and friction at every reset, and writes what is sensed and what is privileged.

    Args:
        seed: of the draws; two envs need different ones.
    """

    def __init__(self, seed: int) -> None:
        super().__init__(out_keys=list(SIZES))
        self.rng = torch.Generator().manual_seed(seed)

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase | None:
        model, data = simulation(self.parent)
        if not hasattr(self, "nominal"):
            self.nominal = model.body_mass.copy(), model.body_inertia.copy(), model.geom_friction.copy()
        self.scaled = 2 * torch.rand(2, generator=self.rng) - 1  # as the encoder reads them
        mass, friction = (1.0 + 0.5 * self.scaled).tolist()
        model.body_mass[:], model.body_inertia[:] = mass * self.nominal[0], mass * self.nominal[1]
        model.geom_friction[:] = friction * self.nominal[2]
        mujoco.mj_setConst(model, data)  # what MuJoCo derives from masses
        return tensordict

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        _, data = simulation(self.parent)
        values = [*data.qpos[2:], *data.ctrl], self.scaled, data.qvel[:3]  # first: along the ground, height, pitch
        for key, value in zip(SIZES, values):
            next_tensordict.set(key, torch.as_tensor(value, dtype=torch.float32).clone())
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the three entries."""
        for key, size in SIZES.items():
            observation_spec[key] = Unbounded((size,), dtype=torch.float32)
        return observation_spec


def make_one(library: str, seed: int) -> EnvBase:
    """Return one cheetah; its history is our transform's, whatever the env."""
    env = TransformedEnv(LIBRARIES[library](), HiddenParameters(seed))
    for transform in (DoubleToFloat(), ObservationHistory(5), StepCounter(200)):
        env.append_transform(transform)
    return env


def main(library: str, iterations: int = 10, num_envs: int = 8, steps: int = 100) -> tuple[ROANetworks, list[float]]:
    """Train, print one line per iteration; return the networks and R² of the estimated velocities, before each."""
    torch.manual_seed(0)
    env = SerialEnv(num_envs, [partial(make_one, library, seed) for seed in range(num_envs)])
    env.set_seed(0)  # the starts, which the simulators draw by generators of their own
    networks = make_networks(env.observation_spec, env.action_spec, estimator="mlp", latent_features=4)
    networks.update_normalizers(env.rollout(steps, break_when_any_done=False))
    collector = Collector(
        env,
        networks.rollout_policy("mixed"),  # half of the cheetahs act on the estimates
        frames_per_batch=num_envs * steps,
        total_frames=num_envs * steps * iterations,
        auto_register_policy_transforms=False,
    )
    loss = ROAClipPPOLoss(
        networks.training_actor("mixed"),
        networks.critic_module,
        networks.encoder_module,
        networks.intrinsic_estimator_module,
        networks.extrinsic_estimator_module,
        extrinsic_scale=networks.ext_norm,
    )
    policy = torch.optim.Adam(networks.policy_parameters(), lr=3e-4)
    estimators = torch.optim.Adam(networks.estimator_parameters(), lr=1e-3)
    explained = []
    for iteration, batch in enumerate(collector):
        with torch.no_grad():
            loss.value_estimator(batch)  # generalised advantage estimation
        batch = batch.reshape(-1)
        truth = batch["privileged", "extrinsic"]
        error = batch["estimate", "extrinsic"] - truth
        explained.append(float(1 - error.square().mean() / truth.var(0).mean()))  # of all components together
        for _ in range(4):
            for minibatch in batch[torch.randperm(len(batch))].chunk(4):
                optimise(policy, loss.policy_loss(minibatch))
                optimise(estimators, loss.adaptation_loss(minibatch))
        networks.update_normalizers(batch)
        print(f"{iteration:3d}  reward {float(batch['next', 'reward'].mean()):+.3f}  R² {explained[-1]:+.2f}")
    collector.shutdown()
    return networks, explained


def optimise(optimizer: torch.optim.Optimizer, terms: TensorDictBase) -> None:
    """Take one optimiser step on the sum of the ``loss_*`` entries."""
    optimizer.zero_grad()
    sum(value for key, value in terms.items() if key.startswith("loss_")).backward()
    optimizer.step()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", choices=LIBRARIES)
    main(parser.parse_args().library)

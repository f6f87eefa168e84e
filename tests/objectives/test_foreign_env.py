"""Our networks and loss on an env that is not ours."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

from torchrl_atr.modules import make_networks
from torchrl_atr.objectives import ROAClipPPOLoss

ROWS, WINDOW = 8, 4


class Cart(EnvBase):
    """A cart on a spring, of unknown mass and hidden speed: it senses its position and the last push."""

    batch_locked = True

    def __init__(self, seed: int = 0) -> None:
        super().__init__(batch_size=(ROWS,))
        privileged = Composite(intrinsic=Unbounded((ROWS, 1)), extrinsic=Unbounded((ROWS, 1)), shape=(ROWS,))
        self.observation_spec = Composite(
            observation=Unbounded((ROWS, 2)),
            history=Unbounded((ROWS, WINDOW, 2)),
            privileged=privileged,
            shape=(ROWS,),
        )
        self.action_spec = Unbounded((ROWS, 1))
        self.reward_spec = Unbounded((ROWS, 1))
        flags = {key: Binary(n=1, shape=(ROWS, 1), dtype=torch.bool) for key in ("done", "terminated")}
        self.full_done_spec = Composite(**flags, shape=(ROWS,))
        self.rng = torch.Generator().manual_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        self.rng.manual_seed(int(seed or 0))

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs) -> TensorDictBase:
        fresh = torch.rand(ROWS, 3, generator=self.rng) * 2 - 1
        self.mass, self.position, self.speed = fresh.split(1, -1)
        self.history = self._sense(torch.zeros(ROWS, 1)).unsqueeze(1).expand(ROWS, WINDOW, 2).clone()
        return self._state(torch.zeros(ROWS, 1))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        push = tensordict["action"].clamp(-1, 1)
        self.history = torch.cat([self.history[:, 1:], self._sense(push).unsqueeze(1)], 1)
        self.speed = 0.8 * self.speed + (push - self.position) / (2 + self.mass)
        self.position = self.position + 0.3 * self.speed
        out = self._state(push)
        out["reward"] = -self.position.square()
        return out

    def _sense(self, push: torch.Tensor) -> torch.Tensor:
        return torch.cat([self.position, push], -1)

    def _state(self, push: torch.Tensor) -> TensorDict:
        privileged = {"intrinsic": self.mass.clone(), "extrinsic": self.speed.clone()}
        state = {"observation": self._sense(push), "history": self.history.clone(), "privileged": privileged}
        done = torch.zeros(ROWS, 1, dtype=torch.bool)
        return TensorDict(state | {"done": done, "terminated": done.clone()}, batch_size=[ROWS])


def test_the_env_is_valid():
    check_env_specs(Cart())


def test_loss_and_estimators_train_on_it():
    torch.manual_seed(0)
    env = Cart()
    networks = make_networks(
        env.observation_spec,
        env.action_spec,
        estimator_kwargs={"channels": 16, "gru_features": 32, "mlp_cells": (32,)},
        latent_features=2,
        actor_cells=(32,),
        critic_cells=(32,),
    )
    networks.update_normalizers(env.rollout(64))  # so that errors are in units of the std at once
    loss = ROAClipPPOLoss(
        networks.training_actor("mixed"),
        networks.critic_module,
        networks.encoder_module,
        networks.intrinsic_estimator_module,
        networks.extrinsic_estimator_module,
        extrinsic_scale=networks.ext_norm,
    )
    policy = torch.optim.Adam(networks.policy_parameters(), 3e-3)
    estimators = torch.optim.Adam(networks.estimator_parameters(), 3e-3)
    collector = Collector(
        env,
        networks.rollout_policy("mixed"),
        frames_per_batch=ROWS * 16,
        total_frames=ROWS * 16 * 12,
        auto_register_policy_transforms=False,  # the GRU starts afresh in every window
    )
    errors = []
    for batch in collector:
        with torch.no_grad():
            loss.value_estimator(batch)
        batch = batch.reshape(-1)
        out = step(policy, loss.policy_loss(batch))
        assert abs(out["max_ratio"].item() - 1) < 1e-4
        errors += [step(estimators, loss.adaptation_loss(batch))["loss_extrinsic"].item() for _ in range(8)]
        networks.update_normalizers(batch)
    collector.shutdown()
    assert errors[0] > 0.3, errors  # in units of the variance: saying "the mean" gives about 1
    assert sum(errors[-10:]) / 10 < errors[0] / 8, errors


def step(optimizer: torch.optim.Optimizer, losses: TensorDictBase) -> TensorDictBase:
    optimizer.zero_grad()
    sum(value for key, value in losses.items() if key.startswith("loss_")).backward()
    optimizer.step()
    return losses

"""An env that is not ours: carts on springs, of unknown mass and hidden speed; networks, loss and callbacks for it."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase, RewardSum, StepCounter, TransformedEnv

from torchrl_atr.modules import ROANetworks, make_networks
from torchrl_atr.objectives import ROAClipPPOLoss
from torchrl_atr.training import Callback

WINDOW = 4


class CartEnv(EnvBase):
    """N carts, which sense their position and the last push; the reward has two terms."""

    batch_locked = True

    def __init__(self, num_envs: int, seed: int = 0) -> None:
        super().__init__(batch_size=(num_envs,))
        n = num_envs

        def values(*shape: int) -> Unbounded:
            return Unbounded((n, *shape))

        self.observation_spec = Composite(
            observation=values(2),
            history=values(WINDOW, 2),
            privileged=Composite(intrinsic=values(1), extrinsic=values(1), shape=(n,)),
            reward_terms=Composite(near=values(1), gentle=values(1), shape=(n,)),
            shape=(n,),
        )
        self.action_spec, self.reward_spec = values(1), values(1)
        flags = {name: Binary(n=1, shape=(n, 1), dtype=torch.bool) for name in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(**flags, shape=(n,))
        self.rng = torch.Generator().manual_seed(seed)
        self.state = TensorDict(batch_size=[n])

    def _set_seed(self, seed: int | None) -> None:
        self.rng.manual_seed(int(seed or 0))

    def get_state(self) -> TensorDictBase:
        return self.state.clone()

    def set_state(self, state: TensorDictBase) -> None:
        self.state = state.clone()

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs) -> TensorDictBase:
        n = self.batch_size[0]
        mass, position, speed = (torch.rand(n, 3, generator=self.rng) * 2 - 1).split(1, -1)
        sensed = torch.cat([position, torch.zeros(n, 1)], -1)
        history = sensed.unsqueeze(1).expand(n, WINDOW, 2).clone()
        fresh = TensorDict(mass=mass, position=position, speed=speed, history=history, batch_size=[n])
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None or self.state.is_empty():
            self.state = fresh
        else:
            self.state = torch.where(mask.reshape(n), fresh, self.state)
        return self._emitted(torch.zeros(n, 1))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        push, state = tensordict["action"].clamp(-1, 1), self.state
        sensed = torch.cat([state["position"], push], -1)
        history = torch.cat([state["history"][:, 1:], sensed.unsqueeze(1)], 1)
        speed = 0.8 * state["speed"] + (push - state["position"]) / (2 + state["mass"])
        self.state = TensorDict(
            mass=state["mass"],
            position=state["position"] + 0.3 * speed,
            speed=speed,
            history=history,
            batch_size=[len(push)],
        )
        out = self._emitted(push)
        out["reward"] = out["reward_terms", "near"] + out["reward_terms", "gentle"]
        return out

    def _emitted(self, push: torch.Tensor) -> TensorDictBase:
        state = self.state.clone()
        flag = torch.zeros_like(push, dtype=torch.bool)
        return TensorDict(
            {
                "observation": torch.cat([state["position"], push], -1),
                "history": state["history"],
                "privileged": {"intrinsic": state["mass"], "extrinsic": state["speed"]},
                "reward_terms": {"near": -state["position"].square(), "gentle": -0.1 * push.square()},
                "done": flag,
                "terminated": flag.clone(),
                "truncated": flag.clone(),
            },
            batch_size=self.batch_size,
        )


def make_cart(num_envs: int, seed: int = 0, num_threads: int | None = None) -> TransformedEnv:
    env = TransformedEnv(CartEnv(num_envs, seed))
    env.append_transform(StepCounter(max_steps=7))
    env.append_transform(RewardSum())
    return env


def make_bare_cart(num_envs: int, seed: int = 0, num_threads: int | None = None) -> EnvBase:
    return CartEnv(num_envs, seed)


def make_cart_networks(env: EnvBase) -> ROANetworks:
    return make_networks(
        env.observation_spec,
        env.action_spec,
        estimator="mlp",
        latent_features=2,
        actor_cells=(16,),
        critic_cells=(16,),
    )


class DoubledLoss(ROAClipPPOLoss):
    """With twice the estimator terms, and a buffer that counts its calls."""

    def __init__(self, networks: ROANetworks, **arguments) -> None:
        super().__init__(
            networks.training_actor("mixed"),
            networks.critic_module,
            networks.encoder_module,
            networks.intrinsic_estimator_module,
            networks.extrinsic_estimator_module,
            intrinsic_coeff=2.0,
            extrinsic_coeff=2.0,
            extrinsic_scale=networks.ext_norm,
            **arguments,
        )
        self.register_buffer("calls", torch.zeros(()))

    def adaptation_loss(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.calls += 1
        return super().adaptation_loss(tensordict)


class Recorder(Callback):
    """Notes what it is called with; what it counts outlives the run."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.count = 0
        self.resumed_at: int | None = None

    def on_train_begin(self, trainer) -> None:
        self.calls.append("train_begin")

    def on_batch(self, batch):
        self.calls.append("batch")
        self.count += 1
        return batch.set(("next", "reward"), 0.5 * batch["next", "reward"])

    def on_minibatch(self, minibatch, phase):
        self.calls.append(f"minibatch {phase}")
        return minibatch

    def on_loss(self, terms, minibatch, phase):
        self.calls.append(f"loss {phase}")
        return terms.set("loss_mine", 0.0 * sum(value for name, value in terms.items() if name.startswith("loss_")))

    def on_iteration(self, metrics):
        self.calls.append("iteration")
        metrics["mine"] = float(self.count)

    def on_checkpoint(self, state) -> None:
        self.calls.append("checkpoint")
        state["mine"] = {"count": self.count}

    def on_resume(self, state) -> None:
        self.resumed_at = state["mine"]["count"]

    def on_train_end(self) -> None:
        self.calls.append("train_end")

    def state_dict(self):
        return {"count": self.count}

    def load_state_dict(self, state) -> None:
        self.count = state["count"]

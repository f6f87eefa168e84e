"""A small environment with the riding env's TensorDict contract, computable by hand."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

PROPRIO = 3


class ToyEnv(EnvBase):
    """Counts its steps. ``proprio`` = [row id, episode, step]; tracking scores are what ``quality``
    says: a number, a pair, or a function of the rows' step.

    ``reward`` is the command's first component at the time of the step, so that a rollout shows which command
    was scored. ``lifetime[i]`` is the step at which row i terminates (0: never).
    """

    batch_locked = True

    def __init__(self, batch_size=(4,), lifetime=0, quality=1.0, device="cpu"):
        super().__init__(device=device, batch_size=torch.Size(batch_size))
        self.lifetime = torch.as_tensor(lifetime, device=device).expand(self.batch_size)
        self.quality = quality
        rows = torch.arange(max(1, self.batch_size.numel()), device=device)
        self.row = rows.reshape(self.batch_size).float()
        self.episode = torch.zeros(self.batch_size, device=device)
        self.time = torch.zeros(self.batch_size, device=device)
        b = self.batch_size
        terms = Composite(forward_command=Unbounded((*b, 1)), steering_command=Unbounded((*b, 1)), shape=b)
        self.observation_spec = Composite(
            proprio=Unbounded((*b, PROPRIO)),
            command=Unbounded((*b, 2)),
            observation=Unbounded((*b, PROPRIO + 2)),
            reward_terms=terms,
            shape=b,
        ).to(device)
        self.state_spec = Composite(command=Unbounded((*b, 2)), shape=b).to(device)
        self.action_spec = Bounded(-1.0, 1.0, (*b, 1), device=device)
        self.reward_spec = Unbounded((*b, 1), device=device)
        flags = {k: Binary(n=1, shape=(*b, 1), dtype=torch.bool) for k in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(**flags, shape=b).to(device)

    def _emit(self, command, score, **extra):
        if command is None:
            command = torch.zeros(*self.batch_size, 2, device=self.device)
        proprio = torch.stack([self.row, self.episode, self.time], -1)
        scores = torch.as_tensor(score, device=self.device, dtype=torch.float32)
        scores = scores.expand(*self.batch_size, 2)
        terminated = ((self.lifetime > 0) & (self.time >= self.lifetime)).unsqueeze(-1)
        return TensorDict(
            {
                "proprio": proprio,
                "command": command.clone(),
                "observation": torch.cat([proprio, command], -1),
                "reward_terms": {"forward_command": scores[..., :1], "steering_command": scores[..., 1:]},
                "terminated": terminated,
                "truncated": torch.zeros_like(terminated),
                "done": terminated.clone(),
                **extra,
            },
            batch_size=self.batch_size,
            device=self.device,
        )

    def _reset(self, tensordict=None, **kwargs):
        mask = None if tensordict is None else tensordict.get("_reset", None)
        mask = torch.ones_like(self.time, dtype=torch.bool) if mask is None else mask.reshape(self.batch_size)
        self.episode = torch.where(mask, self.episode + 1, self.episode)
        self.time = torch.where(mask, torch.zeros_like(self.time), self.time)
        command = None if tensordict is None else tensordict.get("command", None)
        return self._emit(command, 0.0)

    def _step(self, tensordict):
        self.time = self.time + 1
        command = tensordict["command"]
        quality = self.quality(self.time) if callable(self.quality) else self.quality
        return self._emit(command, quality, reward=command[..., :1].clone())

    def _set_seed(self, seed):
        pass


class NestedToyEnv(EnvBase):
    """Counts the steps of two rows, all entries below ``agent``; row i terminates at step ``lifetime[i]``."""

    batch_locked = True
    lifetime = torch.tensor([[2], [4]])

    def __init__(self):
        super().__init__(device="cpu", batch_size=torch.Size([2]))

        def below(**entries):
            return Composite(agent=Composite(**entries, shape=(2,)), shape=(2,))

        self.observation_spec = below(observation=Unbounded((2, 1)))
        self.action_spec = below(action=Bounded(-1.0, 1.0, (2, 1)))
        self.reward_spec = below(reward=Unbounded((2, 1)))
        self.full_done_spec = below(done=Binary(1, (2, 1)), terminated=Binary(1, (2, 1)))
        self.time = torch.zeros(2, 1)

    def _emit(self, **entries):
        ended = self.time >= self.lifetime
        own = {"observation": self.time.clone(), "done": ended, "terminated": ended.clone(), **entries}
        return TensorDict({"agent": TensorDict(own, [2])}, [2])

    def _reset(self, tensordict=None, **kwargs):
        mask = None if tensordict is None else tensordict.get(("agent", "_reset"), None)
        self.time = self.time.masked_fill(torch.ones(2, 1, dtype=torch.bool) if mask is None else mask, 0.0)
        return self._emit()

    def _step(self, tensordict):
        self.time = self.time + 1
        return self._emit(reward=torch.ones(2, 1))

    def _set_seed(self, seed):
        pass

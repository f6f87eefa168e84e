"""Example of the command curriculum and the observation history on an env that is not ours.

    python examples/foreign_transforms.py

The env, a boat, knows nothing of commands: one transform of your own scores its speeds against the command that
``CommandCurriculum`` draws, and the curriculum widens the commands as they are followed.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import CatTensors, EnvBase, StepCounter, Transform, TransformedEnv

from torchrl_atr.envs.transforms import CommandCurriculum, CommandGrid, ObservationHistory

SCORES = [("reward_terms", "speed"), ("reward_terms", "yaw_rate")]
SCALE = 0.5  # m/s and rad/s: errors that cost 63 % of a score


class Boat(EnvBase):
    """Boats that accelerate and turn by two thrusts, against drag; they sense both speeds, (N, 2)."""

    def __init__(self, num_envs: int) -> None:
        super().__init__(batch_size=(num_envs,))
        self.observation_spec = Composite(speeds=Unbounded((num_envs, 2)), shape=(num_envs,))
        self.action_spec = Bounded(-1.0, 1.0, (num_envs, 2))
        self.reward_spec = Unbounded((num_envs, 1))

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        begins = None if tensordict is None else tensordict.get("_reset", None)
        fresh = torch.zeros(*self.batch_size, 2)
        self.speeds = fresh if begins is None else torch.where(begins, fresh, self.speeds)
        return TensorDict(speeds=self.speeds, batch_size=self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.speeds = 0.9 * self.speeds + 0.3 * tensordict["action"]
        none = torch.zeros(*self.batch_size, 1)
        return TensorDict(speeds=self.speeds, reward=none, done=none.bool(), batch_size=self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        """Do nothing: a boat has no randomness."""


class TrackingScores(Transform):
    """Transform that scores speeds against the command in force, exp(-|error| / scale) each; their sum is the reward.

    It goes behind the env and before the curriculum, which reads the scores.
    """

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        scores = (-(next_tensordict["speeds"] - tensordict["command"]).abs() / SCALE).exp()
        for key, score in zip(SCORES, scores.split(1, -1)):
            next_tensordict.set(key, score)
        return next_tensordict.set("reward", scores.sum(-1, keepdim=True))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        for key in SCORES:
            tensordict_reset.set(key, torch.zeros(*self.parent.batch_size, 1))
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare the scores."""
        for key in SCORES:
            observation_spec[key] = Unbounded((*observation_spec.shape, 1))
        return observation_spec


def make_env(num_envs: int = 32, window: int = 25) -> TransformedEnv:
    """Return boats with commands of up to 3 m/s and 2 rad/s, and a history of what they sense and are told."""
    curriculum = CommandCurriculum(
        tracking_max=(1.0, 1.0),  # of both scores, at no error
        tracking_keys=SCORES,
        thresholds=(0.7, 0.7),
        window=window,
        grid=CommandGrid(bounds=(3.0, 2.0)),
        seed=0,
    )
    env = TransformedEnv(Boat(num_envs), TrackingScores())
    for transform in (
        curriculum,
        CatTensors(["speeds", "command"], "observation", sort=False, del_keys=False),
        ObservationHistory(4),
        StepCounter(4 * window),
    ):
        env.append_transform(transform)
    return env


def helm(observation: Tensor) -> Tensor:
    """Return the thrusts that hold the commanded speeds: they balance the drag, and correct the error."""
    speeds, command = observation.split(2, -1)
    return (command / 3.0 + (command - speeds)).clamp(-1.0, 1.0)


def main(steps: int = 1000, num_envs: int = 32) -> list[tuple[float, float]]:
    """Steer boats by a controller; return the largest commands, m/s and rad/s, at first and at last."""
    env = make_env(num_envs)
    curriculum = env.transform[1]
    frontiers = [curriculum.frontier]
    rollout = env.rollout(steps, TensorDictModule(helm, ["observation"], ["action"]), break_when_any_done=False)
    frontiers.append(curriculum.frontier)
    reward = float(rollout["next", "reward"].mean())
    print(f"reward {reward:.2f} of 2; commands up to {frontiers[0]}, then {frontiers[1]} (m/s, rad/s)")
    return frontiers


if __name__ == "__main__":
    main()

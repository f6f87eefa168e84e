"""What the critic sees besides: the law's accelerations, and what tracking would be if they lasted."""

from __future__ import annotations

import math

import torch

from torchrl_atr.envs.models.scene import TIMESTEP
from torchrl_atr.envs.riding import RidingEnv


def test_driven_acceleration_is_what_the_law_does_next():
    env = RidingEnv(num_envs=4, num_threads=1, seed=0, pushes=False)
    td = env.reset()
    for _ in range(20):
        td["action"] = torch.full(env.action_spec.shape, 0.5)
        td = env.step(td)["next"]
    told = td["privileged", "tracking_forecast"][:, 2:4]
    before = env.engine.hook.speeds.clone()
    env.engine.hook.apply(TIMESTEP)
    torch.testing.assert_close(told, ((env.engine.hook.speeds - before) / TIMESTEP).float())
    assert told.abs().amin() > 1e-4


def test_forecast_by_hand():
    env = RidingEnv(num_envs=1, num_threads=1, seed=0, pushes=False)
    td = env.reset()
    td["action"], td["command"] = torch.zeros(env.action_spec.shape), torch.tensor([[0.5, -1.0]])
    env.engine.hook.speeds[:] = torch.tensor([[1.0, 0.2]])
    values = env.step(td)["next", "privileged", "tracking_forecast"][0]
    acceleration, error, kernels = values[2:4], values[4:6], values[6:].reshape(4, 2)
    assert abs(float(error[0]) - 0.5) < 0.02
    assert abs(float(error[1]) - 1.2) < 0.02
    for horizon, kernel in zip((0.0, 0.5, 1.0, 2.0), kernels):
        for axis in range(2):
            expected = math.exp(-abs(float(error[axis] + horizon * acceleration[axis])) / 0.5)
            assert abs(float(kernel[axis]) - expected) < 1e-6

"""Closed-loop episode of a policy in our simulation, recorded for the comparison with ONNX Runtime."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torchrl.envs.utils import step_mdp

from torchrl_atr.deploy.loading import LoadedPolicy
from torchrl_atr.deploy.policy_step import CLOCK, SENSORS
from torchrl_atr.evaluation.access import deterministic
from torchrl_atr.training.loading import grid_range

STEPS, ROBOTS, COMMAND_STEPS = 180, 2, 30
"""Control steps, robots, and control steps that a command lasts: 3.6 s, in which each robot is pushed once."""
COMMANDS = ((1.0, 0.3), *[(12.0, 1.9)] * 3, (0.5, -0.5), (-1.0, 0.0))
"""Forward speeds, m/s, and yaw rates, rad/s, one after the other; one is beyond what is mastered, and lasts until it is
reached at the usual rates of change."""
RESETS = {20: 0, 165: 1, 166: 1}
"""Robot that begins an episode at a step though it has not fallen, by that step."""


def _commands(policy: Any, env: Any) -> list[tuple[float, ...]]:
    """Return commands, for a walking policy within its range: its gait clock runs on the command that is asked for."""
    if CLOCK not in env.base_env.task.observations["proprio"]:
        return list(COMMANDS)
    box = grid_range(env.curriculum.grid)
    limits = getattr(policy, "limits", box)
    return [tuple(limits(box(torch.tensor(each))).tolist()) for each in COMMANDS]


@torch.no_grad()
def record(loaded: LoadedPolicy, seed: int = 0, steps: int = STEPS) -> dict[str, np.ndarray]:
    """Ride with pushes and sensor errors; record readings, commands, starts of episodes and actions.

    Args:
        loaded: policy, and factory of its envs.
        seed: of the env.
        steps: T.

    Returns:
        Arrays (T, N, size) by name of the policy's input, ``start`` (T, N) and ``action``.
    """
    policy, make_env = loaded
    env = make_env(num_envs=ROBOTS, seed=seed, pushes=True)
    commands = _commands(policy, env)
    sizes = env.base_env.runner.terms.observations.sizes["proprio"]
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("start", *SENSORS, "command", "action")}
    start = torch.ones(ROBOTS, dtype=torch.bool)
    with deterministic(policy):
        env.curriculum.pin(commands[0])
        td = env.reset()
        for step in range(steps):
            if step % COMMAND_STEPS == COMMAND_STEPS - 1:  # observed after this step
                env.curriculum.pin(commands[(step // COMMAND_STEPS + 1) % len(commands)])
            td = policy(td)
            parts = dict(zip(sizes, td["proprio"].split(list(sizes.values()), -1)))
            values = {**parts, "command": td["command"], "start": start}
            td = step_mdp(env.step(td))
            values["action"] = env.base_env.runner.previous_action  # with the scripted steps, if there are any
            for name, row in rows.items():
                row.append(values[name].numpy().copy())
            start = td["done"].reshape(-1).clone()
            if step + 1 in RESETS:
                start[RESETS[step + 1]] = True
            if start.any():
                td = env.reset(td.set("_reset", start.unsqueeze(-1)))
    env.close()
    return {name: np.stack(row) for name, row in rows.items()}

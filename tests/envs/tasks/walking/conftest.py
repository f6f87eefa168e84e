"""Walking states made by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from torchrl_atr.envs.models import ROBOTS, FlatGround, Scene, build_scene
from torchrl_atr.envs.tasks import StepContext
from torchrl_atr.envs.tasks.rotations import matrix_from_euler
from torchrl_atr.envs.tasks.walking.state import WalkingState

A1 = ROBOTS.get("a1")
ContextMaker = Callable[..., StepContext]


def _state(**given: object) -> WalkingState:
    """One robot at rest in q0 on the ground, four feet loaded, but for what is ``given``."""
    values: dict[str, Tensor] = {
        "position": torch.tensor([0.0, 0.0, A1.standing_height]),
        "euler": torch.zeros(3),
        "joint_position": torch.tensor(A1.q0),
        "foot_position": torch.zeros(4, 3),
        "foot_velocity": torch.zeros(4, 3),
        "foot_height": torch.zeros(4),
        "foot_force": torch.tensor([0.0, 0.0, 30.0]).expand(4, 3),
        "com": torch.tensor([0.0, 0.0, 0.3]),
        "speeds": torch.zeros(2),
        "lateral_speed": torch.tensor(0.0),
        "height": torch.tensor(A1.standing_height),
    }
    for name in ("velocity", "acceleration", "angular_velocity", "other_force"):
        values[name] = torch.zeros(3)
    for name in ("joint_velocity", "joint_acceleration", "torque", "torque_velocity"):
        values[name] = torch.zeros(12)
    values |= {name: torch.as_tensor(value, dtype=torch.float32) for name, value in given.items()}
    values.setdefault("rotation", matrix_from_euler(*values["euler"]))
    return WalkingState(**{name: value.unsqueeze(0) for name, value in values.items()})


@pytest.fixture(scope="session")
def ground() -> Scene:
    """A1 on flat ground."""
    return build_scene(A1, FlatGround())


@pytest.fixture
def walker(ground: Scene) -> ContextMaker:
    """``walker(command=, action=, phase=, air_time=, terminated=, **state)``: the context of one robot."""

    def make(
        command: tuple[float, float] = (0.0, 0.0),
        action: float = 0.0,
        phase: float = 0.0,
        air_time: object = (0.0,) * 4,
        terminated: bool = False,
        **state: object,
    ) -> StepContext:
        return StepContext(
            state=_state(**state),
            command=torch.tensor([command]),
            action=torch.full((1, 12), action),
            previous_action=torch.zeros(1, 12),
            terminated=torch.tensor([terminated]),
            scene=ground,
            memory={"phase": torch.tensor([[phase]]), "air_time": torch.as_tensor(air_time).reshape(1, 4)},
        )

    return make

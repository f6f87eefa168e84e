"""Riding states made by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS, Scene, Transporter, build_scene
from torchrl_atr.envs.tasks import StepContext
from torchrl_atr.envs.tasks.riding.state import RidingState
from torchrl_atr.envs.tasks.rotations import matrix_from_euler

A1 = ROBOTS.get("a1")
SQUARE = [[0.2, -0.1], [-0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]
"""Feet FR, RR, FL, RL, m."""

StateMaker = Callable[..., RidingState]
ContextMaker = Callable[..., StepContext]


def _state(**given: object) -> RidingState:
    """One robot at rest in q0, 0.28 m above the deck's top, four feet loaded, but for what is ``given``."""
    values: dict[str, Tensor] = {
        "position": torch.tensor([0.0, 0.0, 0.455]),
        "euler": torch.zeros(3),
        "joint_position": torch.tensor(A1.q0),
        "platform_position": torch.tensor([0.0, 0.0, 0.15]),
        "platform_euler": torch.zeros(3),
        "foot_position": torch.cat([torch.tensor(SQUARE), torch.full((4, 1), 0.195)], -1),
        "foot_force": torch.tensor([0.0, 0.0, 30.0]).expand(4, 3),
        "com": torch.tensor([0.0, 0.0, 0.495]),
        "speeds": torch.zeros(2),
        "driving_tilt": torch.zeros(2),
        "driven_acceleration": torch.zeros(2),
        "foot_slip": torch.zeros(4),
    }
    vectors = "velocity acceleration angular_velocity platform_velocity platform_acceleration other_force"
    for name in [*vectors.split(), "platform_angular_velocity", "platform_angular_acceleration"]:
        values[name] = torch.zeros(3)
    for name in ("joint_velocity", "joint_acceleration", "torque", "torque_velocity"):
        values[name] = torch.zeros(12)
    values |= {name: torch.as_tensor(value, dtype=torch.float32) for name, value in given.items()}
    for name, euler in (("rotation", "euler"), ("platform_rotation", "platform_euler")):
        values.setdefault(name, matrix_from_euler(*values[euler]))
    return RidingState(**{name: value.unsqueeze(0) for name, value in values.items()})


@pytest.fixture
def make_state() -> StateMaker:
    """``make_state(field=value, ...)``: one robot standing still but for those fields (no batch axis)."""
    return _state


@pytest.fixture(scope="session")
def scene() -> Scene:
    """A1 on the single board of its size."""
    return build_scene(A1, Transporter(TRANSPORTERS.get("single_board_g1")))


@pytest.fixture
def make_context(scene: Scene) -> ContextMaker:
    """``make_context(command=, action=, previous_action=, terminated=, interpretation=, **state)``, one robot."""

    def make(
        command: tuple[float, float] = (0.0, 0.0),
        action: object = None,
        previous_action: object = None,
        terminated: bool = False,
        interpretation: Interpretation | None = None,
        **state: object,
    ) -> StepContext:
        def row(value: object) -> Tensor:
            return torch.zeros(1, 12) if value is None else torch.as_tensor(value, dtype=torch.float32).reshape(1, 12)

        return StepContext(
            state=_state(**state),
            command=torch.tensor([command]),
            action=row(action),
            previous_action=row(previous_action),
            terminated=torch.tensor([terminated]),
            scene=scene,
            interpretation=interpretation or Interpretation(),
        )

    return make

"""Power and cost of transport by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from torchrl_atr.evaluation.energy import cost_of_transport, measure_power


def test_a_joint_or_a_drive_that_brakes_draws_nothing():
    """Power is torque times the velocity of the same instant, not that which is observed."""
    hook = SimpleNamespace(power=lambda: torch.tensor([-5.0, 7.0], dtype=torch.float64))
    env = SimpleNamespace(engine=SimpleNamespace(hook=hook))
    state = SimpleNamespace(
        torque=torch.tensor([[2.0, -3.0, 1.0], [-4.0, 0.0, 0.5]]),
        torque_velocity=torch.tensor([[1.5, 1.0, -2.0], [-0.5, 9.0, 8.0]]),
        joint_velocity=torch.full((2, 3), 100.0),
    )
    power = measure_power(env, state)
    assert power.joints.tolist() == [[3.0, 0.0, 0.0], [2.0, 0.0, 4.0]]
    assert power.drive.tolist() == [0.0, 7.0]


def test_the_papers_cost_of_transport_is_of_the_mean_joint():
    """Robots of 100 N: at 1 m/s 120 W over 12 joints are 10 W a joint, a tenth of 100 W."""
    joints, drive, speed = np.array([120.0, 480.0]), np.array([60.0, 0.0]), np.array([1.0, 2.0])
    cost = cost_of_transport(joints, drive, np.full(2, 100.0 / 9.81), speed, count=12)
    assert cost.paper == pytest.approx([0.1, 0.2])
    assert cost.joints == pytest.approx([1.2, 2.4])
    assert cost.system == pytest.approx([1.8, 2.4])

"""Dead reckoning: exact with exact sensors, bounded with biased ones, and as sure as it should be."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from torchrl_atr._errors import InputError
from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.interpretation import get_interpretation
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks import riding
from torchrl_atr.envs.tasks.dead_reckoning import (
    BIAS,
    KEY,
    LARGEST_YAW,
    LEAK_TIME,
    METHODS,
    START_STD,
    dead_reckoning,
)
from torchrl_atr.envs.tasks.rotations import matrix_from_euler

FILTERS = ["kalman_filter", "aligned_kalman_filter"]


def drive(
    method: str,
    speed: float,
    yaw_rate: float,
    seconds: float,
    bias: float = 0.0,
    roll: float = 0.0,
    pitch: float = 0.0,
    gravity: bool = False,
) -> tuple[Tensor, Tensor]:
    """Return observation (1, D) and memory (1, size) after a steady drive; the accelerometer has a bias along x.

    With ``gravity`` it also measures the upward reaction that carries the robot.
    """
    group, term = dead_reckoning(method)
    rotation = matrix_from_euler(*torch.tensor([[roll], [pitch], [0.0]]))
    euler = torch.tensor([[roll, pitch, 0.0]])
    state = SimpleNamespace(rotation=rotation, euler=euler, velocity=torch.tensor([[speed, 0.0, 0.0]]))
    turned, dt = yaw_rate * CONTROL_DT, CONTROL_DT  # the difference of velocities over a step, in the frame after it
    world = torch.tensor(
        [[bias + speed * (1.0 - math.cos(turned)) / dt, speed * math.sin(turned) / dt, 9.81 * gravity]]
    )
    sensed = {
        "acceleration": (rotation * world.unsqueeze(-1)).sum(-2),
        "angular_velocity": (rotation * torch.tensor([[0.0, 0.0, yaw_rate]]).unsqueeze(-1)).sum(-2),
        "orientation": euler[:, :2],
    }
    reading = get_interpretation("default", gravity_in_acceleration=gravity)
    context = SimpleNamespace(state=state, interpretation=reading, memory={}, sensed=sensed.__getitem__)
    context.memory[KEY] = term.start(context)
    for _ in range(round(seconds / CONTROL_DT)):
        context.memory[KEY] = term.update(context)
    return group[KEY].function(context), context.memory[KEY]


@pytest.mark.parametrize("method", ["integral", *FILTERS])
@pytest.mark.parametrize(
    "posture",
    [{}, {"roll": 0.2}, {"pitch": 0.3}, {"roll": 0.2, "pitch": -0.3, "gravity": True}],
    ids=["level", "rolled", "pitched", "rolled and pitched, gravity measured"],
)
def test_a_steady_turn_keeps_its_speed_with_exact_sensors(method, posture):
    observed, _ = drive(method, 5.0, 1.0, 30.0, **posture)
    along_x = math.cos(posture.get("pitch", 0.0)) if method == "integral" else 1.0  # of the body, or of its heading
    assert observed[0, 0].item() == pytest.approx(5.0 * along_x, abs=2e-3)


def test_a_bias_grows_without_bound_in_the_integral_and_to_a_bound_in_the_leaky_one():
    drifted = drive("integral", 0.0, 0.0, 60.0, bias=0.05)[0][0, 0].item()
    assert drifted == pytest.approx(0.05 * 60.0, rel=1e-3)
    leaky = drive("leaky_integral", 0.0, 0.0, 60.0, bias=0.05)[0][0, 0].item()
    assert leaky == pytest.approx(0.05 * LEAK_TIME, rel=0.01)


@pytest.mark.parametrize(("method", "within"), zip(FILTERS, (0.02, 0.03)))  # a turned robot would explain some of it
def test_a_turn_shows_the_filter_the_bias(method, within):
    observed, carried = drive(method, 2.0, 0.5, 60.0, bias=0.05)
    assert observed[0, 0].item() == pytest.approx(2.0, abs=0.15)  # the integral is 3 m/s off
    assert carried[0, 2].item() == pytest.approx(0.05, abs=within)


@pytest.mark.parametrize("method", FILTERS)
def test_without_a_turn_the_filter_knows_that_it_knows_less_and_less(method):
    for seconds in (2.0, 5.0):
        std = drive(method, 0.0, 0.0, seconds)[0][0, 2].item()
        assert std == pytest.approx((START_STD**2 + (BIAS * seconds) ** 2) ** 0.5, rel=0.1)
    assert drive(method, 2.0, 0.5, 60.0)[0][0, 2] < 0.3


@pytest.mark.parametrize(("method", "size"), zip(FILTERS, (4, 5)))
def test_a_bias_that_nothing_shows_stays_as_unknown_as_it_was(method, size):
    """The noise of its random process makes up for what the process forgets: the variance is stationary."""
    covariance = drive(method, 0.0, 0.0, 5.0)[1][0, size:].reshape(size, size)
    assert covariance[2, 2].item() == pytest.approx(BIAS**2, rel=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_robot_is_never_taken_to_be_turned_further_than_the_filter_can_find_back(side):
    """It speeds up askew of where it points: every step says that it is turned more."""
    term = dead_reckoning("aligned_kalman_filter")[1]
    level = matrix_from_euler(*torch.zeros(3, 1))
    sensed = {
        "acceleration": torch.tensor([[1.0, -4.0 * side, 0.0]]),
        "angular_velocity": torch.zeros(1, 3),
        "orientation": torch.zeros(1, 2),
    }
    own = SimpleNamespace(rotation=level, euler=torch.zeros(1, 3), velocity=torch.zeros(1, 3))
    context = SimpleNamespace(state=own, interpretation=get_interpretation(), memory={}, sensed=sensed.__getitem__)
    context.memory[KEY], yaws = term.start(context), []
    for _ in range(400):
        context.memory[KEY] = term.update(context)
        yaws.append(context.memory[KEY][0, 4].item() * side)
    assert max(yaws) == pytest.approx(LARGEST_YAW)


@pytest.mark.parametrize(("method", "size"), zip(FILTERS, (4, 5)))
def test_a_covariance_stays_symmetric_and_positive(method, size):
    covariance = drive(method, 3.0, 1.0, 60.0)[1][0, size:].reshape(size, size)
    torch.testing.assert_close(covariance, covariance.T, rtol=1e-3, atol=1e-7)
    assert torch.linalg.eigvalsh(covariance.double()).min() > 0.0


@pytest.mark.parametrize("method", METHODS)
def test_the_mirror_image_of_a_turn_is_reckoned_as_the_mirror_image(method):
    ours, theirs = (drive(method, 1.0, side * 0.5, 5.0, roll=side * 0.1)[0] for side in (1.0, -1.0))
    torch.testing.assert_close(ours * torch.tensor(METHODS[method].mirror), theirs)


@pytest.mark.parametrize("method", METHODS)
def test_it_reads_what_is_sensed_and_not_the_truth(method):
    far = {"acceleration": {"bias": 5.0}}
    envs = [
        QuadrupedEnv(riding(sensors=sensors, velocity_filter=method, pushes=False), 8, seed=0, num_threads=1)
        for sensors in ("ideal", far)
    ]
    exact, biased = (env.rollout(5)["next", KEY][:, -1, :2] for env in envs)
    assert (exact - biased).abs().mean() > 0.1


def weave(method: str, yaw: float, seconds: float) -> Tensor:
    """Return what a robot observes, (1, D), that is turned on a transporter which speeds up, slows down and turns."""
    group, term = dead_reckoning(method)
    level = matrix_from_euler(*torch.zeros(3, 1))
    along = torch.tensor([[math.cos(yaw), -math.sin(yaw), 0.0]])  # the transporter's heading in the robot's frame
    across = torch.tensor([[math.sin(yaw), math.cos(yaw), 0.0]])
    sensed = {"orientation": torch.zeros(1, 2)}
    own = SimpleNamespace(rotation=level, euler=torch.zeros(1, 3), velocity=torch.zeros(1, 3))
    context = SimpleNamespace(state=own, interpretation=get_interpretation(), memory={}, sensed=sensed.__getitem__)
    context.memory[KEY] = term.start(context)
    for step in range(round(seconds / CONTROL_DT)):
        time, rate = step * CONTROL_DT, 2.0 * math.pi / 10.0
        speed, turning = math.sin(rate * time), 0.5 * math.sin(1.7 * rate * time)
        sensed["acceleration"] = along * rate * math.cos(rate * time) + across * turning * speed
        sensed["angular_velocity"] = torch.tensor([[0.0, 0.0, turning]])
        context.memory[KEY] = term.update(context)
    return group[KEY].function(context)


@pytest.mark.parametrize("yaw", [-0.3, 0.0, 0.2])
def test_changes_of_speed_show_the_aligned_filter_how_the_robot_is_turned(yaw):
    start, observed = (weave("aligned_kalman_filter", yaw, seconds)[0] for seconds in (0.02, 62.5))
    assert observed[3].item() == pytest.approx(yaw, abs=0.05)
    assert observed[4] < start[4] + 0.02  # its own random walk alone would have added 0.2 rad
    speed = torch.tensor([math.cos(yaw), -math.sin(yaw)])  # after a quarter of the last period
    torch.testing.assert_close(observed[:2], speed, atol=0.15, rtol=0.0)


def test_a_turn_corrects_a_velocity_that_drifted():
    """After minutes without a turn: a lateral acceleration of ψ̇ v shows v within seconds."""
    group, term = dead_reckoning("kalman_filter")
    level, state = matrix_from_euler(*torch.zeros(3, 1)), torch.tensor([[2.0, 0.0, 0.0]])
    sensed = {
        "acceleration": torch.tensor([[0.0, 2.0, 0.0]]),
        "angular_velocity": torch.tensor([[0.0, 0.0, 1.0]]),
        "orientation": torch.zeros(1, 2),
    }
    own = SimpleNamespace(rotation=level, euler=torch.zeros(1, 3), velocity=state)
    context = SimpleNamespace(state=own, interpretation=get_interpretation(), memory={}, sensed=sensed.__getitem__)
    context.memory[KEY] = term.start(context)
    context.memory[KEY][0, [0, 4]] += torch.tensor([3.0, 9.0])  # v_x and its variance
    for _ in range(round(10.0 / CONTROL_DT)):
        context.memory[KEY] = term.update(context)
    assert group[KEY].function(context)[0, 0].item() == pytest.approx(2.0, abs=0.3)


def test_an_unknown_method_is_named():
    with pytest.raises(InputError, match="velocity_filter 'magic'"):
        riding(velocity_filter="magic")
    with pytest.raises(InputError, match="unknown method 'magic'"):
        dead_reckoning("magic")


def test_each_component_has_its_unit():
    ours = QuadrupedEnv(riding(velocity_filter="aligned_kalman_filter"), 1, num_threads=1).runner.terms.observations
    assert [unit for _, unit in ours.labels(KEY)] == ["m/s", "m/s", "m/s", "rad", "rad"]

"""Clock, air time and gait reward by their closed forms."""

from __future__ import annotations

import math

import pytest
import torch

from torchrl_atr.envs.tasks.walking.gait import CLOCK_MIRROR, LEG_PHASE, MEMORY, SWING_HEIGHT, clock, gait, moving

FORWARD = (1.0, 0.0)
GRAVITY_OF_A_FOOT = torch.tensor([0.0, 0.0, 30.0])
SIDES_SWAPPED = [2, 3, 0, 1]
"""FL, RL, FR, RR for FR, RR, FL, RL."""


def on_target(phase: float) -> dict[str, torch.Tensor]:
    """Feet as a trot at this phase has them: half a cycle up and down, half a cycle loaded."""
    own = (phase + LEG_PHASE) % 1.0
    swinging = own < 0.5
    height = torch.where(swinging, 0.06 * torch.sin(2.0 * math.pi * own), torch.zeros(4))
    return {"foot_height": height, "foot_force": GRAVITY_OF_A_FOOT * (~swinging).float().unsqueeze(-1)}


@pytest.mark.parametrize("phase", [0.0, 0.1, 0.25, 0.49, 0.5, 0.6, 0.75, 0.99])
def test_feet_exactly_on_the_target_earn_one(walker, phase):
    assert gait(walker(FORWARD, phase=phase, **on_target(phase))).item() == pytest.approx(1.0, abs=1e-5)


def test_diagonal_legs_swing_together_and_half_a_cycle_apart(walker):
    for phase, up in ((0.25, [True, False, False, True]), (0.75, [False, True, True, False])):
        feet = on_target(phase)
        assert (feet["foot_height"] > 0.05).tolist() == up
        assert gait(walker(FORWARD, phase=(phase + 0.5) % 1.0, **feet)).item() < 0.1  # the other two


def test_each_foot_off_its_target_costs_its_quarter(walker):
    feet = on_target(0.25)
    low = feet["foot_height"] - torch.tensor([SWING_HEIGHT / 2, 0.0, 0.0, 0.0])
    assert gait(walker(FORWARD, phase=0.25, **{**feet, "foot_height": low})).item() == pytest.approx(7 / 8)
    lifted = feet["foot_force"] * torch.tensor([1.0, 0.0, 1.0, 1.0]).unsqueeze(-1)
    assert gait(walker(FORWARD, phase=0.25, **{**feet, "foot_force": lifted})).item() == pytest.approx(3 / 4)


@pytest.mark.parametrize("command", [(0.0, 0.0), (0.1, -0.1)])
def test_standing_still_wants_four_feet_down_whatever_the_clock(walker, command):
    for phase in (0.0, 0.3, 0.8):
        assert moving(walker(command, phase=phase)).item() == 0.0
        assert gait(walker(command, phase=phase)).item() == 1.0
        assert gait(walker(command, phase=phase, **on_target(phase))).item() == pytest.approx(0.5)
        assert clock(walker(command, phase=phase)).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("command", [(0.11, 0.0), (0.0, -0.11), (-0.5, 0.0)])
def test_more_than_standing_still_is_walking(walker, command):
    assert moving(walker(command)).item() == 1.0
    torch.testing.assert_close(clock(walker(command, phase=0.125)), torch.full((1, 2), math.sqrt(0.5)))


@pytest.mark.parametrize(("speed", "cycles"), [(0.0, 2.0), (1.0, 2.5), (3.0, 3.5), (-1.0, 2.5)])
def test_the_clock_makes_two_cycles_a_second_and_half_a_cycle_more_for_each_metre_a_second(walker, speed, cycles):
    phase, turned = 0.0, 0.0
    for _ in range(50):
        following = MEMORY["phase"].update(walker((speed, 0.5), phase=phase)).item()
        assert 0.0 <= following < 1.0
        turned += (following - phase) % 1.0
        phase = following
    assert turned == pytest.approx(cycles, abs=1e-4)


def test_the_mirror_image_of_the_clock_is_half_a_cycle_later(walker):
    for phase in (0.0, 0.2, 0.7):
        image = clock(walker((1.0, -0.5), phase=(phase + 0.5) % 1.0))
        expected = clock(walker((1.0, 0.5), phase=phase)) * torch.tensor(CLOCK_MIRROR)
        torch.testing.assert_close(image, expected, atol=1e-5, rtol=0)


def test_mirrored_feet_earn_the_same_half_a_cycle_later(walker):
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        height, phase = 0.08 * torch.rand(4, generator=generator), torch.rand((), generator=generator).item()
        force = GRAVITY_OF_A_FOOT * (torch.rand(4, 1, generator=generator) > 0.5)
        one = gait(walker((1.0, 0.5), phase=phase, foot_height=height, foot_force=force))
        swapped = {"foot_height": height[SIDES_SWAPPED], "foot_force": force[SIDES_SWAPPED]}
        other = gait(walker((1.0, -0.5), phase=(phase + 0.5) % 1.0, **swapped))
        torch.testing.assert_close(one, other, atol=1e-5, rtol=0)


def test_air_time_counts_the_steps_of_feet_in_the_air_and_starts_anew_with_a_contact(walker):
    air_time = torch.zeros(1, 4)
    for step in range(1, 11):
        force = GRAVITY_OF_A_FOOT * torch.tensor([[0.0], [1.0], [float(step % 5 == 0)], [float(step > 4)]])
        air_time = MEMORY["air_time"].update(walker(air_time=air_time, foot_force=force))
    torch.testing.assert_close(air_time, torch.tensor([[0.2, 0.0, 0.0, 0.0]]))
    force = GRAVITY_OF_A_FOOT * torch.tensor([[1.0], [0.0], [0.0], [0.02]])  # 0.6 N is no contact
    air_time = MEMORY["air_time"].update(walker(air_time=air_time, foot_force=force))
    torch.testing.assert_close(air_time, torch.tensor([[0.0, 0.02, 0.02, 0.02]]))

from __future__ import annotations

import pytest
import torch
from torchrl.objectives.utils import KLAdaptiveLR

from torchrl_atr.objectives import DeviceKLAdaptiveLR, LinearSchedule


def test_ramp(make_loss):
    loss = make_loss()
    schedule = LinearSchedule(loss, "roa_coeff", 0.2, 1.0, begin=0.25, until=0.75)
    for progress, expected in [(0.0, 0.2), (0.25, 0.2), (0.5, 0.6), (0.75, 1.0), (1.0, 1.0), (1.5, 1.0)]:
        assert schedule.step(progress) == pytest.approx(expected)
        assert loss.roa_coeff.item() == pytest.approx(expected)


def test_default_is_the_ancestors_ramp(make_loss):
    loss = make_loss()
    schedule = LinearSchedule(loss)
    assert loss.roa_coeff.item() == 0.0
    schedule.step(1.0)
    assert loss.roa_coeff.item() == pytest.approx(0.1)


def test_any_coefficient_of_the_loss(make_loss):
    loss = make_loss()
    LinearSchedule(loss, "entropy_coeff", 0.01, 0.001).step(0.5)
    assert loss.entropy_coeff.item() == pytest.approx(0.0055)


def test_state_dict_round_trip(make_loss):
    loss = make_loss()
    first = LinearSchedule(loss)
    first.step(0.3)
    second = LinearSchedule(loss)
    second.load_state_dict(first.state_dict())
    assert loss.roa_coeff.item() == pytest.approx(0.03)
    assert second.state_dict() == first.state_dict()


def test_bad_input(make_loss):
    with pytest.raises(ValueError, match=r"gamma.*roa_coeff"):
        LinearSchedule(make_loss(), "gamma")
    with pytest.raises(ValueError, match="begin"):
        LinearSchedule(make_loss(), begin=0.5, until=0.5)


def rate_schedule(kind, **settings):
    optimizer = torch.optim.Adam([torch.nn.Parameter(torch.ones(1))], lr=1e-3, fused=True)
    return kind(optimizer, target_kl=0.01, factor=2.0, min_lr=1e-4, max_lr=5e-3, **settings)


def test_rates_are_those_of_torchrl_bounds_and_new_targets_included():
    ours, theirs = rate_schedule(DeviceKLAdaptiveLR), rate_schedule(KLAdaptiveLR)
    for kl in (0.05, 0.021, 0.02, 0.001, 0.0, *[0.002] * 4, 0.005, *[0.5] * 7, 0.0049):
        ours.step(torch.tensor(kl))
        theirs.step(kl)
        assert ours.get_last_lr() == pytest.approx(theirs.get_last_lr(), rel=1e-5)
    ours.target_kl = theirs.target_kl = 1.0
    ours.step(torch.tensor(0.4))
    theirs.step(0.4)
    assert ours.get_last_lr() == pytest.approx(theirs.get_last_lr(), rel=1e-5)
    assert ours.get_last_lr()[0] > 1e-4


def test_a_rate_stays_where_it_is_held_and_where_nothing_finite_is_known():
    schedule = rate_schedule(DeviceKLAdaptiveLR)
    for kl, hold in ((0.5, torch.tensor(True)), (float("nan"), None), (float("inf"), torch.tensor(False))):
        schedule.step(torch.tensor(kl), hold)
        assert schedule.get_last_lr() == pytest.approx([1e-3])
    assert schedule.exceeded(torch.tensor(0.06), 5.0)
    assert not schedule.exceeded(torch.tensor(0.04), 5.0)


def test_an_optimiser_steps_at_the_rate_and_a_restored_one_goes_on_with_its_own():
    schedule = rate_schedule(DeviceKLAdaptiveLR)
    schedule.step(torch.tensor(0.5))
    (weight,) = schedule.optimizer.param_groups[0]["params"]
    weight.grad = torch.ones(1)
    schedule.optimizer.step()
    assert weight.item() == pytest.approx(1.0 - 5e-4)  # Adam's first step is as long as its rate
    restored = rate_schedule(DeviceKLAdaptiveLR)
    restored.optimizer.load_state_dict(schedule.optimizer.state_dict())
    restored.load_state_dict(schedule.state_dict())
    restored.step(torch.tensor(0.001))
    assert restored.get_last_lr() == pytest.approx([1e-3])
    assert restored.optimizer.param_groups[0]["lr"] is restored.rate
    assert schedule.get_last_lr() == pytest.approx([5e-4])


def test_old_checkpoints_hold_a_number():
    schedule = rate_schedule(DeviceKLAdaptiveLR)
    plain = rate_schedule(KLAdaptiveLR)
    plain.step(0.5)
    schedule.optimizer.load_state_dict(plain.optimizer.state_dict())
    schedule.load_state_dict(plain.state_dict())
    assert schedule.get_last_lr() == pytest.approx([5e-4])

from __future__ import annotations

import pytest

from torchrl_atr.objectives import LinearSchedule


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

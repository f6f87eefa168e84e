"""Readings and profiles: names, overrides, ranges."""

from __future__ import annotations

import dataclasses
import math

import pytest

from torchrl_atr.envs.profiles import PROFILES, Readings, get_readings


def test_profiles_are_default_literal_and_ancestor():
    assert PROFILES.names()[:3] == ("default", "literal", "ancestor")
    assert get_readings() == Readings() == PROFILES.get("default")


def test_literal_takes_the_paper_at_its_word():
    literal = get_readings("literal")
    assert not literal.relative_mass
    assert not literal.odd_resistance
    assert literal.sb_unit == 1.0
    assert not literal.rewards_times_dt
    assert get_readings().sb_unit == pytest.approx(57.29578)


def test_ancestor_clips_rewards_and_reports_an_imu():
    ancestor = get_readings("ancestor")
    assert ancestor.positive_rewards
    assert ancestor.gravity_in_acceleration
    assert ancestor.tilt_limit == 0.78


def test_overrides_replace_fields_of_a_profile_or_of_own_readings():
    literal = get_readings("literal")
    assert get_readings("literal", coulomb_smoothing=0.5) == dataclasses.replace(literal, coulomb_smoothing=0.5)
    assert get_readings(Readings(tilt_limit=0.5), positive_rewards=True).tilt_limit == 0.5


def test_unknown_profile_and_reading_list_the_known_ones():
    with pytest.raises(ValueError, match="unknown profile 'paper'; known: default, literal, ancestor"):
        get_readings("paper")
    with pytest.raises(ValueError, match="unknown reading 'gravity'; known: relative_mass"):
        get_readings("default", gravity=True)


@pytest.mark.parametrize(
    ("name", "value"),
    [("coulomb_smoothing", -0.1), ("steering_smoothing", 2.0), ("tilt_limit", 0.0), ("tilt_limit", math.nan)],
)
def test_values_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"reading {name}=.* choose a value in"):
        Readings(**{name: value})

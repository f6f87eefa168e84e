"""Interpretations and profiles: names, overrides, ranges."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch

from torchrl_atr.envs.factory import make_riding_env
from torchrl_atr.envs.interpretation import PROFILES, Interpretation, get_interpretation, points
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.training import RECIPE_POINTS


def test_profiles_are_default_literal_and_ancestor():
    assert PROFILES.names()[:3] == ("default", "literal", "ancestor")
    assert get_interpretation() == Interpretation() == PROFILES.get("default")


def test_literal_takes_the_paper_at_its_word():
    literal = get_interpretation("literal")
    assert not literal.relative_mass
    assert not literal.odd_resistance
    assert literal.sb_unit == 1.0
    assert not literal.rewards_times_dt
    assert get_interpretation().sb_unit == pytest.approx(57.29578)


def test_ancestor_clips_rewards_and_reports_an_imu():
    ancestor = get_interpretation("ancestor")
    assert ancestor.positive_rewards
    assert ancestor.gravity_in_acceleration
    assert ancestor.tilt_limit == 0.78


def test_overrides_replace_fields_of_a_profile_or_of_own_readings():
    literal = get_interpretation("literal")
    assert get_interpretation("literal", coulomb_smoothing=0.5) == dataclasses.replace(literal, coulomb_smoothing=0.5)
    assert get_interpretation(Interpretation(tilt_limit=0.5), positive_rewards=True).tilt_limit == 0.5


def test_every_reading_gives_its_reason_in_two_lines_and_every_profile_follows_from_it():
    for name, point in {**points(), **RECIPE_POINTS}.items():
        assert len(point.why.splitlines()) == 2, name
        assert point.number
    for name, point in points().items():
        for profile in ("literal", "ancestor"):
            chosen = getattr(point, profile)
            expected = getattr(Interpretation(), name) if chosen is None else chosen
            assert getattr(get_interpretation(profile), name) == expected


def test_table_i_taken_literally_gives_thirteen_extrinsic_states():
    env = RidingEnv(num_envs=1, profile="literal", seed=0, num_threads=1)
    assert env.observation_spec["privileged", "extrinsic"].shape == (1, 13)
    assert env.rollout(2)["privileged", "extrinsic"].isfinite().all()


def test_pd_gains_taken_literally_are_table_iis_for_every_robot():
    for profile, gain in (("default", 150.0), ("literal", 40.0)):
        env = RidingEnv("spot", num_envs=1, profile=profile, randomization="off", seed=0, num_threads=1)
        gains = env.engine.fields["actuator_gainprm"][0, env.scene.layout.actuators, 0]
        assert gains == pytest.approx([gain] * 12, rel=1e-6)


def test_the_history_may_end_with_the_current_observation():
    for included in (False, True):
        readings = Interpretation(current_in_history=included)
        ride = make_riding_env(num_envs=2, profile=readings, seed=0, num_threads=1).rollout(3)
        newest = ride["history"][..., -1, :]
        assert torch.equal(newest, ride["observation"]) is included
        assert included or torch.equal(newest[:, 1:], ride["observation"][:, :-1])


def test_unknown_profile_and_reading_list_the_known_ones():
    with pytest.raises(ValueError, match="unknown profile 'paper'; known: default, literal, ancestor"):
        get_interpretation("paper")
    with pytest.raises(ValueError, match="unknown reading 'gravity'; known: relative_mass"):
        get_interpretation("default", gravity=True)


@pytest.mark.parametrize(
    ("name", "value"),
    [("coulomb_smoothing", -0.1), ("steering_smoothing", 2.0), ("tilt_limit", 0.0), ("tilt_limit", math.nan)],
)
def test_values_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"reading {name}=.* choose a value in"):
        Interpretation(**{name: value})

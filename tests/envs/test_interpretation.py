"""Interpretations and profiles: names, overrides, ranges."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch

from torchrl_atr.envs.factory import make_riding_env
from torchrl_atr.envs.interpretation import PROFILES, Interpretation, get_interpretation, open_questions
from torchrl_atr.envs.riding import RidingEnv


def test_profiles_are_those_of_the_presets():
    assert PROFILES.names()[:4] == ("default", "paper", "literal", "legged_gym")
    assert get_interpretation() == Interpretation() == PROFILES.get("default")


def test_paper_keeps_what_makes_its_text_true_and_drops_what_is_added():
    assert get_interpretation("paper") == Interpretation(
        coulomb_smoothing=0.0, driven_smoothness=False, aligned_com=False
    )


def test_literal_takes_the_paper_at_its_word():
    literal = get_interpretation("literal")
    assert not literal.relative_mass
    assert not literal.odd_resistance
    assert literal.sb_unit == 1.0
    assert not literal.rewards_times_dt
    assert get_interpretation().sb_unit == pytest.approx(57.29578)


def test_legged_gym_clips_rewards_and_reports_an_imu():
    theirs = get_interpretation("legged_gym")
    assert theirs.positive_rewards
    assert theirs.gravity_in_acceleration
    assert theirs.tilt_limit == 0.78


def test_overrides_replace_fields_of_a_profile_or_of_ones_own():
    literal = get_interpretation("literal")
    assert get_interpretation("literal", coulomb_smoothing=0.5) == dataclasses.replace(literal, coulomb_smoothing=0.5)
    assert get_interpretation(Interpretation(tilt_limit=0.5), positive_rewards=True).tilt_limit == 0.5


def test_every_question_gives_its_reason():
    for name, question in open_questions().items():
        assert question.question, name
        assert question.text.count(". "), name  # what it is, and why


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
        interpretation = Interpretation(current_in_history=included)
        ride = make_riding_env(num_envs=2, profile=interpretation, seed=0, num_threads=1).rollout(3)
        newest = ride["history"][..., -1, :]
        assert torch.equal(newest, ride["observation"]) is included
        assert included or torch.equal(newest[:, 1:], ride["observation"][:, :-1])


def test_unknown_profile_and_question_list_the_known_ones():
    with pytest.raises(ValueError, match="unknown profile 'printed'; known: default, paper, literal"):
        get_interpretation("printed")
    with pytest.raises(ValueError, match="unknown open question 'gravity'; known: relative_mass"):
        get_interpretation("default", gravity=True)


@pytest.mark.parametrize(
    ("name", "value"),
    [("coulomb_smoothing", -0.1), ("steering_smoothing", 2.0), ("tilt_limit", 0.0), ("tilt_limit", math.nan)],
)
def test_values_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"task.interpretation.{name}=.* choose a number in"):
        Interpretation(**{name: value})

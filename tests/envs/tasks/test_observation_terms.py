"""Observation terms as data: what cannot be used is named before the first step; errors of sensors are as declared."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from torchrl_atr._errors import InputError
from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.tasks import ObservationError, ObservationTerm, Task, riding

STILL = riding(pushes=False)


def height(c) -> Tensor:
    return c.state.position[:, 2:]


def sensed(**errors: float) -> Task:
    """Riding with a constant 2 observed in proprio, with these errors."""
    term = ObservationTerm(lambda c: torch.full((len(c.command), 1), 2.0), mirror=(1.0,), **errors)
    return STILL.with_observation("proprio", two=term)


def make(task: Task, num_envs: int = 3, **arguments: object) -> QuadrupedEnv:
    return QuadrupedEnv(task, num_envs, **{"seed": 0, "num_threads": 1, **arguments})


def steps(env: QuadrupedEnv, count: int, key: str = "proprio") -> Tensor:
    """The last component of an entry, at the reset and after each step, (count + 1, N)."""
    kept, generator = [env.reset()[key][:, -1]], torch.Generator().manual_seed(0)
    for _ in range(count):
        action = 0.05 * torch.randn(env.action_spec.shape, generator=generator)
        kept.append(env.step(TensorDict({"action": action}, env.batch_size))["next", key][:, -1])
    return torch.stack(kept)


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (lambda c: c.action, "'mine' of 'proprio' is <function"),
        (ObservationTerm(lambda c: c.action[:, 0]), r"'mine' of 'proprio' returned \(3,\) of float32"),
        (ObservationTerm(lambda c: c.action[:1]), r"'mine' of 'proprio' returned \(1, 12\) of float32"),
        (
            ObservationTerm(lambda c: c.action.double()),
            r"'mine' of 'proprio' returned \(3, 12\) of float64; .* shape \(3, D\)",
        ),
        (ObservationTerm(lambda c: c.action > 0), r"'mine' of 'proprio' returned \(3, 12\) of bool"),
        (ObservationTerm(lambda c: 1.0), "'mine' of 'proprio' returned float"),
        (ObservationTerm(lambda c: c.state.nose), "'mine' of 'proprio' failed: AttributeError: .*nose"),
        (
            ObservationTerm(height, unit=("m", "s")),
            "'mine' of 'proprio' has 1 components and 2 units",
        ),
        (ObservationTerm(height, mirror=(1.0, -1.0)), r"'mine' of 'proprio' is of \(2, 2\); it has 1 components"),
        (
            ObservationTerm(height, mirror="x"),
            "the mirror image of the observation term 'mine' of 'proprio' failed: TypeErr",
        ),
        (
            ObservationTerm(height, mirror=1.0),
            "the mirror image of the observation term 'mine' of 'proprio' failed: Runtime",
        ),
        (ObservationTerm(height, mirror=(2.0,)), "'mine' of 'proprio' is no signed permutation"),
    ],
)
def test_a_term_that_cannot_be_used_is_named_before_the_first_step(term, message):
    with pytest.raises(ObservationError, match=message):
        make(STILL.with_observation("proprio", mine=term))


@pytest.mark.parametrize(
    ("mirror", "message"),
    [
        (None, "'mine' of 'proprio' has no mirror image; give it mirror=..., or train with symmetric=false"),
        (lambda scene: torch.eye(5), r"'mine' of 'proprio' is of \(5, 5\); it has 1 components"),
        (lambda scene: scene.nose, "'mine' of 'proprio' failed: AttributeError: .*nose"),
        (lambda scene: None, "'mine' of 'proprio' failed"),
    ],
)
def test_a_term_without_a_mirror_image_of_its_size_is_named_by_whoever_needs_it(mirror, message):
    env = make(STILL.with_observation("proprio", mine=ObservationTerm(height, mirror)))
    env.rollout(1)
    with pytest.raises(ObservationError, match=message):
        _ = env.reflections


def test_a_command_whose_mirror_image_is_of_another_size_is_named():
    task = riding("a1", "single_board", pushes=False)
    task = task.replace(command=dataclasses.replace(task.command, mirror=(1.0,)))
    with pytest.raises(InputError, match=r"the command of 'riding' is of \(1, 1\); it has 2 components"):
        _ = make(task).reflections


@pytest.mark.parametrize(
    ("key", "terms", "message"),
    [
        ("observation", {"mine": ObservationTerm(height)}, "'observation' is an entry of every env"),
        ("command", {"mine": ObservationTerm(height)}, "'command' is an entry of every env"),
        (("reward_terms", "mine"), {"mine": ObservationTerm(height)}, "is an entry of every env"),
        (("privileged", "intrinsic"), {"mine": ObservationTerm(height)}, "is an entry of every env"),
        (("proprio", "mine"), {"mine": ObservationTerm(height)}, "lies inside another group"),
        (("mine",), {"mine": ObservationTerm(height)}, r"write the key \('mine',\) as 'mine'"),
        (3, {"mine": ObservationTerm(height)}, "give a key: a text or a tuple of texts"),
        ("mine", {}, "'mine' holds {}; give it ObservationTerms by name"),
        ("mine", ObservationTerm(height), "give it ObservationTerms by name"),
    ],
)
def test_a_group_that_no_env_can_hold_is_named(key, terms, message):
    with pytest.raises(InputError, match=message):
        make(STILL.replace(observations={**STILL.observations, key: terms}))


def test_groups_nest_as_deep_as_one_likes():
    env = make(STILL.with_observation(("mine", "seen", "height"), height=ObservationTerm(height)))
    after = env.rollout(2)["next", "mine", "seen", "height"]
    assert after.shape == (3, 2, 1) == (*env.observation_spec["mine", "seen", "height"].shape[:1], 2, 1)
    state = env.get_state()
    env.rollout(1)
    env.set_state(state)
    assert torch.equal(env.get_state()["emitted", "mine", "seen", "height"], after[:, -1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"function": 3}, "function=3 of an observation term cannot be called"),
        ({"noise": -0.1}, "noise=-0.1"),
        ({"bias": float("nan")}, "bias=nan"),
        ({"delay": 51.0}, "delay=51.0"),
    ],
)
def test_a_number_out_of_range_is_named_where_it_is_written(arguments, message):
    with pytest.raises(ObservationError, match=message):
        ObservationTerm(**{"function": height, **arguments})


def test_an_own_term_reaches_specs_data_and_reflections():
    task = STILL.with_observation("proprio", height=ObservationTerm(height, (1.0,), unit="m"))
    env = make(task.with_observation("mine", turned=ObservationTerm(lambda c: c.state.euler, (-1.0, 1.0, -1.0))))
    assert env.observation_spec["proprio"].shape == (3, 45)
    assert env.observation_spec["observation"].shape == (3, 47)
    assert env.reflections["proprio"].shape == (45, 45)
    assert env.reflections["mine"].diagonal().tolist() == [-1.0, 1.0, -1.0]
    assert env.runner.terms.observations.labels("proprio")[-1] == ("height", "m")
    after = env.rollout(2)["next"]
    torch.testing.assert_close(after["proprio"][:, -1, -1], env.engine.qpos[:, env.scene.layout.root_qpos + 2].float())
    assert after["mine"].shape == (3, 2, 3)


def test_noise_has_its_declared_standard_deviation_and_is_drawn_anew_at_every_step():
    values = steps(make(sensed(noise=0.3), 100), 30) - 2.0
    assert values.std().item() == pytest.approx(0.3, rel=0.05)
    assert values.mean().abs() < 0.03
    correlation = (values[1:] * values[:-1]).mean() / values.var()
    assert correlation.abs() < 0.06


def test_a_bias_stays_for_an_episode_and_differs_between_robots_and_episodes():
    env = make(sensed(bias=0.3), 400)
    first = steps(env, 5) - 2.0
    torch.testing.assert_close(first, first[:1].expand_as(first))
    assert first[0].std().item() == pytest.approx(0.3, rel=0.15)
    assert first[0].unique().numel() > 390
    assert (steps(env, 1)[0] - 2.0 != first[0]).float().mean() > 0.99


def test_a_delayed_value_lies_between_the_step_before_and_now_by_a_share_of_the_episodes_own():
    late = ObservationTerm(lambda c: c.state.joint_velocity, delay=0.5)
    prompt = ObservationTerm(lambda c: c.state.joint_velocity)
    env = make(STILL.with_observation("late", v=late).with_observation("prompt", v=prompt), 300)
    td, generator = env.reset(), torch.Generator().manual_seed(0)
    assert torch.equal(td["late"], td["prompt"])  # nothing came before
    before = td["prompt"]
    share = 0.5 * env.runner.sensor_errors.state["delay of late"]
    assert 0.0 <= share.min() < 0.05 < 0.45 < share.max() <= 0.5
    for _ in range(5):
        td = env.step(td.set("action", 0.05 * torch.randn(300, 12, generator=generator)))["next"]
        torch.testing.assert_close(td["late"], (1.0 - share) * td["prompt"] + share * before)
        before = td["prompt"]


def test_a_delay_of_several_steps_lies_between_the_two_steps_around_it():
    late = ObservationTerm(lambda c: c.state.joint_velocity, delay=2.5)
    prompt = ObservationTerm(lambda c: c.state.joint_velocity)
    env = make(STILL.with_observation("late", v=late).with_observation("prompt", v=prompt), 60)
    td, generator = env.reset(), torch.Generator().manual_seed(0)
    seen = [td["prompt"]] * 4  # before the start, everything was as at the start
    share = 2.5 * env.runner.sensor_errors.state["delay of late"]
    assert share.max() > 2.0
    for _ in range(6):
        td = env.step(td.set("action", 0.05 * torch.randn(60, 12, generator=generator)))["next"]
        seen = [td["prompt"], *seen[:3]]
        values, whole = torch.stack(seen), share.floor().long().squeeze(-1)
        rows = torch.arange(60)
        torch.testing.assert_close(td["late"], values[whole, rows].lerp(values[whole + 1, rows], share.frac()))


def test_a_bias_that_wanders_keeps_its_standard_deviation_and_forgets_in_its_correlation_time():
    values = steps(make(sensed(bias=0.3, bias_time=0.2), 400), 60) - 2.0
    assert values.std(1).mean().item() == pytest.approx(0.3, rel=0.05)
    ten_later = (values[10:] * values[:-10]).mean() / values.var()
    assert ten_later.item() == pytest.approx(math.exp(-1.0), abs=0.06)


def test_what_is_privileged_and_what_declares_no_error_stays_exact():
    plain, noisy = make(STILL), make(sensed(noise=0.3, bias=0.2, delay=0.5))
    noisy.set_state(plain.get_state().update(noisy.runner.sensor_errors.state).exclude("emitted"))
    action = TensorDict({"action": torch.full((3, 12), 0.1)}, [3])
    plain.set_state(plain.get_state().exclude("emitted"))
    ours, theirs = (env.step(action.clone())["next"] for env in (plain, noisy))
    for key in ours.keys(True, True):
        if key not in ("proprio", "observation"):
            assert torch.equal(ours[key], theirs[key]), key
    assert torch.equal(ours["proprio"], theirs["proprio"][:, :-1])
    assert torch.equal(theirs["observation"], torch.cat([theirs["proprio"], theirs["command"]], -1))


def test_a_restored_state_goes_on_bit_for_bit_with_the_generators_state():
    task = sensed(noise=0.3, bias=0.2, delay=0.5)
    env, generator = make(task), torch.Generator().manual_seed(0)
    env.reset()
    actions = [TensorDict({"action": 0.1 * torch.randn(3, 12, generator=generator)}, [3]) for _ in range(12)]
    for action in actions[:6]:
        env.step(action.clone())
    state, drawn = env.get_state(), env.rng.get_state()
    one = torch.stack([env.step(action.clone())["next"] for action in actions[6:]])
    other = make(task, seed=5)
    other.set_state(state)
    other.rng.set_state(drawn)
    two = torch.stack([other.step(action.clone())["next"] for action in actions[6:]])
    assert (one == two).all()

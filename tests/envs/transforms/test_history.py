from __future__ import annotations

import io

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import SerialEnv, TransformedEnv
from toy import NestedToyEnv, ToyEnv

from torchrl_atr.envs.transforms import ObservationHistory, task_transforms

H = 3


def make(batch=(4,), lifetime=0, length=H):
    return TransformedEnv(ToyEnv(batch, lifetime=lifetime), ObservationHistory(length))


def expected(data, length):
    """The definition, row by row, step by step: o_{t-H} ... o_{t-1} of this episode, o_0 in front of it."""
    observation, time = data["observation"], data["proprio"][..., 2].long()
    out = torch.empty(*observation.shape[:2], length, observation.shape[-1])
    for row in range(out.shape[0]):
        for t in range(out.shape[1]):
            start = t - int(time[row, t])
            if start >= 0:
                past = [observation[row, max(start, t - length + k)] for k in range(length)]
                out[row, t] = torch.stack(past)
    return out


def check(data, length=H):
    data = data.reshape(-1, data.shape[-1])
    assert torch.equal(data["history"], expected(data, length))
    # the history that comes with the true last observation of an episode is of that episode
    following = torch.cat([data["history"][..., 1:, :], data["observation"].unsqueeze(-2)], -2)
    assert torch.equal(data["next", "history"], following)


def test_by_hand():
    history = make((1,)).rollout(5)["history"][0, :, :, 2]  # the step each frame is of
    assert history.tolist() == [[0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 1, 2], [1, 2, 3]]


def test_with_the_current_observation_at_its_end():
    env = TransformedEnv(ToyEnv((1,), lifetime=3), ObservationHistory(H, include_current=True))
    data = env.rollout(4, break_when_any_done=False)
    assert data["history"][0, :, :, 2].tolist() == [[0, 0, 0], [0, 0, 1], [0, 1, 2], [0, 0, 0]]
    assert torch.equal(data["history"][..., -1, :], data["observation"])


@pytest.mark.parametrize("length", [1, 3, 10])
@pytest.mark.parametrize("batch", [(), (4,), (2, 2)])
def test_never_across_an_episode(batch, length):
    lifetime = torch.tensor([3, 0, 7, 1])[: max(1, torch.Size(batch).numel())].reshape(batch)
    data = make(batch, lifetime, length).rollout(25, break_when_any_done=False)
    assert data["next", "done"].any()
    check(data, length)


@pytest.mark.parametrize("outside", [True, False])
def test_behind_serial_env(outside):
    if outside:
        env = TransformedEnv(
            SerialEnv(2, [lambda: ToyEnv((2,), lifetime=3), lambda: ToyEnv((2,))]), ObservationHistory(H)
        )
    else:
        env = SerialEnv(2, [lambda: make((2,), 3), lambda: make((2,))])
    check(env.rollout(15, break_when_any_done=False))


def test_partial_reset_leaves_the_other_rows():
    env = make()
    td = env.rollout(5)[:, -1]["next"].exclude("reward")
    mask = torch.tensor([False, True, False, True])[:, None]
    reset = env.reset(td.clone().set("_reset", mask))
    assert torch.equal(reset["history"][~mask[:, 0]], td["history"][~mask[:, 0]])
    assert torch.equal(reset["history"][1], reset["observation"][1].expand(H, -1))
    _, td = env.step_and_maybe_reset(env.rand_action(reset))
    assert td["history"][0, :, 2].tolist() == [3, 4, 5]
    assert td["history"][1, :, 2].tolist() == [0, 0, 0]


def test_holds_the_command_that_was_in_force():
    env = TransformedEnv(
        ToyEnv((4,), lifetime=torch.tensor([0, 0, 8, 5])),
        task_transforms((1.0, 1.0), history_length=H, window=4, max_steps=11, seed=0),
    )
    data = env.rollout(30, break_when_any_done=False)
    check(data)
    commands = data["history"][0, 5, :, -2:]  # o_2, o_3, o_4; the command changed between steps 3 and 4
    assert torch.equal(commands, data["command"][0, 2:5])
    assert not torch.equal(commands[1], commands[2])


def test_emitted_histories_are_never_rewritten():
    env = make(lifetime=torch.tensor([2, 3, 0, 5]))
    td, kept = env.reset(), []
    for _ in range(12):
        step, td = env.step_and_maybe_reset(env.rand_action(td))
        kept.append((step["next", "history"], step["next", "history"].clone()))
    assert all(torch.equal(now, then) for now, then in kept)


def test_what_users_change_in_place_changes_nothing_else():
    env = make()
    td, first = env.reset(), None
    for _ in range(3):
        first = td["history"].clone()
        step, after = env.step_and_maybe_reset(env.rand_action(td))
        step["next", "history"].fill_(7.0)
        assert torch.equal(td["history"], first)
        td = after
    assert not (env.step(env.rand_action(td))["next", "history"] == 7.0).any()


def test_an_env_whose_flags_are_nested_resets_the_rows_that_ended():
    keys = {"in_key": ("agent", "observation"), "out_key": ("agent", "history")}
    env = TransformedEnv(NestedToyEnv(), ObservationHistory(2, **keys))
    history = env.rollout(4, break_when_any_done=False)["agent", "history"].squeeze(-1)
    assert history.tolist() == [[[0, 0], [0, 0], [0, 0], [0, 0]], [[0, 0], [0, 0], [0, 1], [1, 2]]]


def observed(value, grad=False):
    return TensorDict({"observation": torch.full((2, 1), float(value), requires_grad=grad)}, [2])


def ridden(history, values, start=0.0):
    """The histories of a reset and of steps with these observations, without an env."""
    data = [history._reset(TensorDict({}, [2]), observed(start))]
    for value in values:
        data.append(history._step(data[-1], observed(value)))
    return data


def test_graphs_of_emitted_histories_can_be_walked_back_later():
    weight = torch.ones(3, requires_grad=True)
    data = ridden(ObservationHistory(3), range(1, 9))
    total = sum((step["history"][0, :, 0] * weight).sum() for step in data)
    total.backward()
    # o_{t-3}, o_{t-2}, o_{t-1} of t = 0 ... 8, o_0 = 0 in front
    assert weight.grad.tolist() == [sum(range(6)), sum(range(7)), sum(range(8))]


def test_gradients_reach_observations_that_carry_them():
    history = ObservationHistory(3)
    data, total = history._reset(TensorDict({}, [2]), observed(0)), 0.0
    inputs = [observed(value, grad=True) for value in range(1, 6)]
    for step in inputs:
        data = history._step(data, step.copy())
        total = total + data["history"].sum()
    total.backward()
    counts = [step["observation"].grad for step in inputs]
    assert [count[0, 0].item() if count is not None else 0.0 for count in counts] == [3, 3, 2, 1, 0]


def test_what_began_in_inference_mode_goes_on_outside():
    history = ObservationHistory(3)
    with torch.inference_mode():
        data = ridden(history, [1.0])[-1]
    for value in range(2, 6):
        data = history._step(data, observed(value))
    assert data["history"][0, :, 0].tolist() == [2, 3, 4]


def test_a_clone_has_frames_of_its_own():
    history = ObservationHistory(3)
    data = ridden(history, range(1, 4))[-1]
    twin = history.clone()
    for value in range(4, 12):
        ours, theirs = history._step(data, observed(value)), twin._step(data, observed(-value))
        assert ours["history"][0, -1, 0] == (value - 1 if value > 4 else 3)
        assert theirs["history"][0, -1, 0] == (1 - value if value > 4 else 3)


def test_dtype_and_keys():
    env = make((2,)).append_transform(ObservationHistory(2, in_key="command", out_key=("past", "command")))
    env.append_transform(ObservationHistory(2, in_key=("reward_terms", "forward_command"), out_key="scores"))
    data = env.rollout(3)
    assert data["past", "command"].shape == (2, 3, 2, 2)
    assert data["scores"][0, :, :, 0].tolist() == [[0, 0], [0, 0], [0, 1]]
    history = ObservationHistory(2)
    td = TensorDict({"observation": torch.ones(2, 5, dtype=torch.float64)}, [2])
    assert history._reset(td.empty(), td)["history"].dtype == torch.float64


def test_state_dict_round_trip_before_and_after_the_first_reset():
    env, other = make(lifetime=6), make(lifetime=6)
    other.load_state_dict(env.state_dict())  # stock CatFrames cannot do this
    td = env.rollout(4)[:, -1]["next"].exclude("reward")
    file = io.BytesIO()
    torch.save(env.state_dict(), file)
    file.seek(0)
    other.load_state_dict(torch.load(file, weights_only=True))
    other.base_env.time = env.base_env.time.clone()
    other.base_env.episode = env.base_env.episode.clone()
    runs = [e.rollout(8, break_when_any_done=False, auto_reset=False, tensordict=td.clone()) for e in (env, other)]
    assert torch.equal(runs[0]["next", "history"], runs[1]["next", "history"])


def test_misuse_is_named():
    with pytest.raises(ValueError, match="length must be at least 1"):
        ObservationHistory(0)
    env = TransformedEnv(ToyEnv((2,)), ObservationHistory(2, in_key="pixels"))
    with pytest.raises(KeyError, match="is not among"):
        env.observation_spec  # noqa: B018
    env = make()
    with pytest.raises(RuntimeError, match="before the first reset"):
        env.step(env.fake_tensordict())

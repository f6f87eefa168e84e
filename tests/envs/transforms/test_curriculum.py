from __future__ import annotations

import io

import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.data import Composite, Unbounded
from torchrl.envs import Compose, RenameTransform, SerialEnv, TransformedEnv
from torchrl.envs.utils import RandomPolicy
from toy import NestedToyEnv, ToyEnv

from torchrl_atr.envs import make_riding_env
from torchrl_atr.envs.transforms import CommandCurriculum, CommandGrid, task_transforms

CENTRE = (75, 10)


def make(batch=(4,), window=5, seed=0, **kwargs):
    toy = {name: kwargs.pop(name) for name in ("lifetime", "quality") if name in kwargs}
    return TransformedEnv(ToyEnv(batch, **toy), CommandCurriculum((1.0, 1.0), window=window, seed=seed, **kwargs))


def only(*cells):
    weights = torch.zeros(CommandGrid().shape)
    for row, column in cells:
        weights[row, column] = 1.0
    return weights


def check_timing(data, window, batch):
    """Reward t is for command t; a command lasts ``window`` steps from its reset; done rows keep theirs."""
    data = data.reshape(-1, data.shape[-1])
    now, then, done = data["command"], data["next", "command"], data["next", "done"][..., 0]
    assert torch.equal(data["next", "reward"], now[..., :1])
    assert torch.equal(data["observation"][..., -2:], now)
    assert torch.equal(data["next", "observation"][..., -2:], then)
    assert torch.equal(then[:, :-1][~done[:, :-1]], now[:, 1:][~done[:, :-1]])
    step = data["next", "proprio"][..., 2].long()
    changed = (now != then).any(-1)
    assert torch.equal(changed, (step % window == 0) & ~done)
    assert changed.any()
    assert done.any()


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_timing(batch):
    lifetime = torch.tensor([7, 0, 10, 3, 9, 8])[: max(1, torch.Size(batch).numel())].reshape(batch)
    env = TransformedEnv(
        ToyEnv(batch, lifetime=lifetime), task_transforms((1.0, 1.0), history_length=3, window=5, seed=0)
    )
    check_timing(env.rollout(40, break_when_any_done=False), 5, batch)


@pytest.mark.parametrize("order", ["serial of transformed", "transformed serial"])
@pytest.mark.parametrize("batch", [(), (3,)])
def test_timing_behind_serial_env(order, batch):
    def toy(life):
        return ToyEnv(batch, lifetime=life)

    def stack(seed):
        return task_transforms((1.0, 1.0), history_length=3, window=5, seed=seed)

    if order == "transformed serial":
        env = TransformedEnv(SerialEnv(2, [lambda: toy(7), lambda: toy(0)]), stack(0))
    else:
        makers = [lambda: TransformedEnv(toy(7), stack(0)), lambda: TransformedEnv(toy(0), stack(1))]
        env = SerialEnv(2, makers)
    check_timing(env.rollout(30, break_when_any_done=False), 5, batch)


def test_reset_draws_for_masked_rows_only():
    env = make()
    before = env.reset()["command"]
    mask = torch.tensor([True, False, False, True])[:, None]
    env.rand_step(env.fake_tensordict())
    curriculum = env.transform
    curriculum.rows.elapsed.copy_(torch.tensor([1, 2, 3, 4]))
    after = env.reset(TensorDict({"_reset": mask}, [4]))
    assert torch.equal((curriculum.command != before).any(-1), mask[:, 0])
    assert torch.equal(after["command"][mask[:, 0]], curriculum.command[mask[:, 0]])
    assert curriculum.rows.elapsed.tolist() == [0, 2, 3, 0]


def test_initial_commands_fill_the_initial_box():
    commands = make((4000,)).reset()["command"]
    assert (commands.abs() <= torch.tensor([0.5, 0.3])).all()
    assert (commands.amax(0) > torch.tensor([0.49, 0.29])).all()
    assert (commands.amin(0) < torch.tensor([-0.49, -0.29])).all()


def test_success_grows_the_grid_as_computed_by_hand():
    env = make()
    curriculum = env.transform
    curriculum.load_weights(only(CENTRE))
    env.rollout(4)
    assert torch.equal(curriculum.weights, only(CENTRE))  # the window is not over
    env.rollout(5)  # four rows succeed on the same cell: 4 x 0.1 for each neighbour
    expected = torch.zeros(151, 21)
    expected[74:77, 9:12] = 0.4
    expected[75, 10] = 1.0
    torch.testing.assert_close(curriculum.weights, expected)
    assert curriculum.frontier == (0.3, 0.3)
    assert curriculum.command_area == pytest.approx((4.2 / 3171, 4.2 * 0.04))


@pytest.mark.parametrize(
    ("quality", "grows"),
    [
        (0.81, True),
        (0.79, False),
        (torch.tensor([1.0, 0.79]), False),  # both must pass
        (torch.tensor([0.79, 1.0]), False),
        (lambda t: torch.where(t <= 1, 0.0, 1.0)[:, None], True),  # mean over five steps: 0.8
        (lambda t: torch.where(t <= 2, 0.0, 1.0)[:, None], False),  # 0.6
        (float("nan"), False),
    ],
)
def test_window_mean_against_threshold(quality, grows):
    env = make(quality=quality, thresholds=(0.799, 0.799))
    start = env.transform.weights.clone()
    env.rollout(5)
    assert (env.transform.weights.sum() > start.sum()) == grows


def test_score_from_leaves_out_the_settling_time():
    def quality(t):
        return torch.where(t <= 2, float("nan"), 0.85)[:, None]

    env = make(quality=quality, score_from=2)
    env.rollout(5)
    assert env.transform.weights.sum() > 15


def test_tracking_max_scales_the_threshold():
    env = TransformedEnv(
        ToyEnv((4,), quality=torch.tensor([0.02, 0.01])), CommandCurriculum((0.02, 0.01), window=5, seed=0)
    )
    env.rollout(5)
    assert env.transform.weights.sum() > 15
    env = TransformedEnv(
        ToyEnv((4,), quality=torch.tensor([0.02, 0.01])), CommandCurriculum((0.02, 0.02), window=5, seed=0)
    )
    env.rollout(5)
    assert env.transform.weights.sum() == 15


@pytest.mark.parametrize("lifetime", [4, 5, 9])
def test_early_termination_fails(lifetime):
    env = make(lifetime=lifetime, window=10 if lifetime == 9 else 5)  # 9 of 10 perfect steps would average 0.9
    env.rollout(40, break_when_any_done=False)
    assert env.transform.weights.sum() == 15


def test_a_window_that_ends_with_the_time_limit_counts():
    env = TransformedEnv(ToyEnv((4,)), task_transforms((1.0, 1.0), history_length=2, max_steps=5, window=5, seed=0))
    data = env.rollout(5, break_when_any_done=False)
    assert data["next", "truncated"][:, -1].all()
    assert env.transform[0].weights.sum() > 15


def test_a_bad_score_does_not_survive_its_window():
    def quality(t):
        return torch.where(t == 1, float("nan"), 1.0)[:, None]

    env = make(quality=quality)
    env.rollout(5)
    assert env.transform.weights.sum() == 15
    env = make(quality=quality)
    env.rollout(10)
    assert env.transform.weights.sum() > 15


def test_weights_never_fall_in_a_run():
    env = make((16,), lifetime=torch.arange(16), window=3)
    td, last = env.reset(), env.transform.weights.clone()
    for _ in range(40):
        _, td = env.step_and_maybe_reset(env.rand_action(td))
        assert (env.transform.weights >= last).all()
        last = env.transform.weights.clone()
    assert last.max() == 1
    assert last.sum() > 15


def test_pinned_rows_keep_their_command_and_never_count():
    env = make(lifetime=7)
    env.transform.pin([1.5, -0.5], mask=torch.tensor([True, True, True, True]))
    data = env.rollout(40, break_when_any_done=False)
    assert (data["command"] == torch.tensor([1.5, -0.5])).all()
    assert env.transform.weights.sum() == 15


def test_only_pinned_rows_are_left_out():
    env = make()
    curriculum = env.transform
    curriculum.load_weights(only(CENTRE))
    env.reset()
    commands = torch.tensor([[3.0, 1.0], [0.0, 0.0], [-15.0, 2.0], [0.0, 0.0]])
    mask = torch.tensor([True, False, True, False])
    curriculum.pin(commands, mask)
    data = env.rollout(6, auto_reset=True)
    assert torch.equal(data["command"][mask], commands[mask][:, None].expand(2, 6, 2))
    assert (data["command"][~mask].abs() <= 0.3).all()
    assert curriculum.weights[74, 9] == pytest.approx(0.2)  # two of four rows
    assert curriculum.frontier == (0.3, 0.3)


def test_a_moving_start_is_not_scored():
    env = make_riding_env(num_envs=64, num_threads=1, seed=0, moving_start=0.5, window=3, max_steps=6)
    td = env.reset()
    moving, rows = td["speeds"].ne(0).any(-1), env.transform[0].rows
    assert torch.equal(td["moving_start"].squeeze(-1), moving)
    assert 10 < int(moving.sum()) < 54
    assert torch.equal(rows.cells < 0, moving)
    for _ in range(3):
        td["action"] = torch.zeros(env.action_spec.shape)
        _, td = env.step_and_maybe_reset(td)
    assert (rows.cells >= 0).all()  # the next window counts for all


def test_released_rows_finish_their_window_uncounted():
    env = make(quality=1.0)
    env.reset()
    env.transform.pin((2.0, 1.0))
    td = env.rollout(3)[:, -1]["next"].exclude("reward")
    env.transform.unpin()
    data = env.rollout(3, auto_reset=False, tensordict=td)
    assert (data["next", "command"][:, 0] == torch.tensor([2.0, 1.0])).all()
    assert (data["next", "command"][:, 1] != torch.tensor([2.0, 1.0])).any()  # due after five steps in all
    assert env.transform.weights.sum() == 15


def test_a_stray_command_is_not_a_pin():
    env = make()
    td = env.reset(TensorDict({"command": torch.full((4, 2), 9.0)}, [4]))
    assert (td["command"].abs() <= 0.5).all()
    assert torch.equal(td["observation"][:, -2:], td["command"])


def test_two_seeds_differ_and_one_seed_repeats():
    first, second, again = (make(seed=s).rollout(12)["command"] for s in (0, 1, 0))
    assert torch.equal(first, again)
    assert not (first == second).any()
    env = make(seed=None)
    assert not (env.reset()["command"] == make(seed=None).reset()["command"]).any()
    env.transform.set_seed(0)
    assert torch.equal(env.reset()["command"], first[:, 0])
    env.set_seed(0)  # reaches the base environment only, as TorchRL defines it
    assert not torch.equal(env.reset()["command"], first[:, 0])


def test_state_dict_round_trip_samples_identically():
    env, other = make(window=4), make(window=4, seed=99)
    env.transform.pin((1.0, 1.0), torch.tensor([False, False, False, True]))
    td = env.rollout(10)[:, -1]["next"].exclude("reward")  # in the middle of a window
    file = io.BytesIO()
    torch.save(env.state_dict(), file)
    file.seek(0)
    state = torch.load(file, weights_only=True)
    other.load_state_dict(state)  # a fresh environment, never reset
    data = [e.rollout(15, auto_reset=False, tensordict=td.clone()) for e in (env, other)]
    assert torch.equal(data[0]["command"], data[1]["command"])
    assert torch.equal(data[0]["next", "command"], data[1]["next", "command"])
    assert torch.equal(env.transform.weights, other.transform.weights)
    assert env.transform.weights.sum() > 15
    assert torch.equal(env.reset()["command"], other.reset()["command"])


def test_limits_are_part_of_the_state():
    env, other = make(), make()
    env.transform.load_weights(torch.ones(CommandGrid().shape))
    env.transform.limit((1.0, 0.4))
    other.load_state_dict(env.state_dict())
    commands = other.rollout(50, break_when_any_done=False)["command"].reshape(-1, 2)
    assert (commands.abs() <= torch.tensor([1.1, 0.5]) + 1e-6).all()
    old = env.transform.get_extra_state()
    del old["limits"]  # of checkpoints from before limits were saved
    other.transform.set_extra_state(old)
    assert other.transform.limits.part.bounds == CommandGrid().bounds


def test_an_env_whose_flags_are_nested():
    keys = {"tracking_keys": [("agent", "reward")], "command_key": ("agent", "command")}
    curriculum = CommandCurriculum((1.0,), **keys, thresholds=(0.8,), window=3, seed=0)
    data = TransformedEnv(NestedToyEnv(), curriculum).rollout(8, break_when_any_done=False)
    command, ended = data["agent", "command"], data["next", "agent", "done"][..., 0]
    changed = (command[:, 1:] != command[:, :-1]).any(-1)
    assert ended.nonzero().tolist() == [[0, 1], [0, 3], [0, 5], [0, 7], [1, 3], [1, 7]]
    assert torch.equal(changed[0], ended[0, :-1])  # episodes of two steps; a window lasts three
    assert changed[1].nonzero()[:, 0].tolist() == [2, 3, 6]


def test_a_command_has_the_dtype_that_the_env_declares():
    base = ToyEnv()
    spec = base.observation_spec.clone()
    spec["command"] = Unbounded((4, 2), dtype=torch.float64)
    base.observation_spec, base.state_spec = spec, Composite(shape=(4,))
    env = TransformedEnv(base, CommandCurriculum((1.0, 1.0), seed=0))
    assert env.reset()["command"].dtype == torch.float64


def test_state_of_another_batch_size_keeps_weights_and_renews_rows():
    env, other = make((4,)), make((6,))
    env.rollout(20)
    other.load_state_dict(env.state_dict())
    assert torch.equal(other.transform.weights, env.transform.weights)
    assert other.reset()["command"].shape == (6, 2)


def test_state_of_another_grid_is_refused():
    env = make()
    other = make(grid=CommandGrid(increment=0.2))
    with pytest.raises(ValueError, match="grid"):
        other.load_state_dict(env.state_dict())


def test_clone_is_independent():
    env = make()
    env.reset()
    copy = env.transform.clone()
    twin = TransformedEnv(ToyEnv((4,)), copy)
    twin.load_state_dict(env.state_dict())
    assert torch.equal(env.rollout(20)["command"], twin.rollout(20)["command"])  # neither disturbs the other
    copy.load_weights(only(CENTRE))
    assert env.transform.weights.sum() > 1


def test_merge_commutes():
    runs = [make((8,), seed=seed) for seed in (0, 1)]
    for env in runs:
        env.rollout(30)
    a, b = (env.transform.weights.clone() for env in runs)
    assert not torch.equal(a, b)
    for env, other in zip(runs, (b, a)):
        env.transform.merge_(other)
    assert torch.equal(runs[0].transform.weights, runs[1].transform.weights)
    assert torch.equal(runs[0].transform.weights, torch.maximum(a, b))


def test_collectors_map_fn_reaches_the_weights():
    env = TransformedEnv(ToyEnv((4,)), task_transforms((1.0, 1.0), history_length=2, window=5, seed=0))
    collector = Collector(
        env,
        RandomPolicy(env.action_spec),
        frames_per_batch=8,
        total_frames=16,
        auto_register_policy_transforms=False,
    )
    weights = only((100, 15))
    collector.map_fn("env.transform[0].load_weights", list_of_args=[(weights,)])
    assert torch.equal(env.transform[0].weights, weights)
    commands = env.reset()["command"]
    assert (CommandGrid().cell_of(commands) == 100 * 21 + 15).all()
    collector.shutdown()


def test_renamed_keys_in_an_env_that_knows_no_such_command():
    curriculum = CommandCurriculum(
        (1.0,), tracking_keys=["score"], thresholds=(0.8,), command_key=("goal", "velocity"), window=3, seed=0
    )
    rename = RenameTransform([("reward_terms", "forward_command")], ["score"])
    env = TransformedEnv(ToyEnv((4,)), Compose(rename, curriculum))
    data = env.rollout(7)
    assert data["goal", "velocity"].shape == (4, 7, 2)
    assert (data["goal", "velocity"][:, 2] != data["goal", "velocity"][:, 3]).any(-1).all()
    assert curriculum.weights.sum() > 15


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"tracking_max": (1.0,)}, "one entry per score"),
        ({"tracking_max": (1.0, 0.0)}, "tracking_max="),
        ({"tracking_max": (1.0, float("nan"))}, "tracking_max="),
        ({"tracking_max": (1.0, 1.0), "window": 5, "score_from": 5}, "score_from"),
        ({"tracking_max": (1.0, 1.0), "window": 0}, "score_from"),
    ],
)
def test_bad_settings_are_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        CommandCurriculum(**arguments)


@pytest.mark.parametrize(
    ("command", "mask", "words"),
    [
        ([1.0, 1.0, 1.0], None, r"shape \(2,\) or \(4, 2\)"),
        (torch.zeros(3, 2), None, r"shape \(2,\) or \(4, 2\)"),
        ([15.1, 0.0], None, "within"),
        ([0.0, -2.1], None, "within"),
        ([float("nan"), 0.0], None, "finite"),
        ([0.0, 0.0], torch.ones(3, dtype=torch.bool), "mask"),
        ([0.0, 0.0], torch.ones(4), "mask"),
    ],
)
def test_bad_pins_are_named(command, mask, words):
    env = make()
    with pytest.raises(ValueError, match=words):
        env.transform.pin(command, mask)


def test_misuse_is_named():
    with pytest.raises(RuntimeError, match="not attached"):
        CommandCurriculum((1.0, 1.0)).pin((0.0, 0.0))
    env = make()
    with pytest.raises(RuntimeError, match="before the first reset"):
        env.step(env.fake_tensordict())
    env = make(tracking_keys=[("reward_terms", "forward_command"), "speed"])
    with pytest.raises(KeyError, match="speed"):
        env.rollout(2)
    with pytest.raises(ValueError, match="shape"):
        make().transform.load_weights(torch.ones(3, 3))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_the_same_seed_draws_the_same_commands_on_a_gpu():
    curriculum = CommandCurriculum((1.0, 1.0), window=5, seed=0)
    env = TransformedEnv(ToyEnv((4,), device="cuda"), curriculum)
    data = env.rollout(20)
    assert data["command"].device.type == curriculum.weights.device.type == "cuda"
    torch.testing.assert_close(data["command"].cpu(), make().rollout(20)["command"])

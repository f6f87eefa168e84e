"""``RidingEnv``: specs, resets that touch only their rows, seeds, state, divergence, bad input."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from mujoco.batch import SimulationError
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import check_env_specs

from torchrl_atr.envs.physics.batch import BatchEngine
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks.runner import EpisodeRunner


def make(num_envs: int = 4, **kwargs: object) -> RidingEnv:
    return RidingEnv(num_envs=num_envs, **{"seed": 0, "num_threads": 1, **kwargs})


def act(env: RidingEnv, generator: torch.Generator, scale: float = 0.3) -> TensorDict:
    action = scale * torch.randn(env.action_spec.shape, generator=generator)
    return TensorDict({"action": action}, env.batch_size)


def mask(*rows: int, n: int = 4) -> TensorDict:
    chosen = torch.zeros(n, 1, dtype=torch.bool)
    chosen[list(rows)] = True
    return chosen


def reset(env: RidingEnv, rows: torch.Tensor, last: TensorDictBase) -> TensorDictBase:
    return env.reset(last.clone().set("_reset", rows))


def simulation(engine: BatchEngine) -> dict[str, np.ndarray]:
    """All that a simulation is: state, bookkeeping, outputs and compiled parameters."""
    arrays = {**engine.get_state(), **engine.fields, "time": engine.time, "sensordata": engine.sensordata}
    arrays |= {"driven": engine.hook.acceleration(), "force": engine.actuator_force}
    return {name: np.array(value) for name, value in arrays.items()}


@pytest.mark.parametrize(("physics", "num_envs"), [("batch", 3), ("dm_control", 1)])
def test_specs(physics, num_envs):
    check_env_specs(make(num_envs, physics=physics), break_when_any_done="both")


def test_values_are_float32_and_named_as_promised():
    env = make(2)
    td = env.rollout(2)
    assert env.batch_size == (2,)
    shapes = {"proprio": 44, "command": 2, "observation": 46, "action": 12}
    for key, size in shapes.items():
        assert td[key].shape == (2, 2, size)
    assert td["privileged", "intrinsic"].shape[-1] == 34
    assert td["privileged", "extrinsic"].shape[-1] == 16
    for key in td.keys(True, True):
        assert td[key].dtype in (torch.float32, torch.bool), key
    assert env.model.key(0).name == "stand"


def test_partial_reset_leaves_the_other_rows_bitwise_alone():
    env, generator = make(), torch.Generator().manual_seed(0)
    env.reset()
    for _ in range(15):
        last = env.step(act(env, generator))["next"].exclude("reward")
    before = simulation(env.engine)
    after_td = reset(env, mask(1, 3), last)
    after = simulation(env.engine)
    for name, value in before.items():
        np.testing.assert_array_equal(after[name][[0, 2]], value[[0, 2]], err_msg=name)
    observed = [key for key in env.observation_spec.keys(True, True) if key[0] != "reward_terms"]
    for key in observed:
        assert torch.equal(after_td[key][[0, 2]], last[key][[0, 2]]), key
        if key not in ("command", "moving_start"):
            assert (after_td[key][[1, 3]] != last[key][[1, 3]]).any(-1).all(), key
    # fresh parameters, a standing robot, a transporter at rest
    for name in (
        "body_mass",
        "body_ipos",
        "actuator_gainprm",
        "geom_friction",
        "jnt_stiffness",
        "dof_damping",
    ):
        changed = (after[name] != before[name]).reshape(4, -1).any(-1)
        assert changed.tolist() == [False, True, False, True], name
    assert (after["speeds"][[1, 3]] == 0).all()
    assert (after["qvel"][[1, 3]] == 0).all()
    assert (after["world_offset"][[1, 3]] == 0).all()
    assert (after_td["proprio"][[1, 3], -12:] == 0).all()  # no previous action


def test_an_untouched_row_rides_on_as_if_nothing_had_been_reset():
    def trajectory(rows: torch.Tensor | None) -> torch.Tensor:
        env, generator = make(pushes=False), torch.Generator().manual_seed(0)
        env.reset()
        kept = []
        for step in range(12):
            td = env.step(act(env, generator))["next"]
            kept.append(td["observation"])
            if step == 5 and rows is not None:
                reset(env, rows, td.exclude("reward"))
        return torch.stack(kept)

    alone, beside = trajectory(None), trajectory(mask(1, 3))
    assert torch.equal(alone[:, [0, 2]], beside[:, [0, 2]])
    assert not torch.equal(alone[7:, [1, 3]], beside[7:, [1, 3]])


def test_the_terminal_observation_is_the_true_one():
    env = make(2)
    td = env.reset()
    layout = env.scene.layout
    env.engine.qpos[1, layout.root_qpos] += 1.0
    td["action"] = torch.zeros(2, 12)
    stepped, following = env.step_and_maybe_reset(td)
    assert stepped["next", "terminated"].tolist() == [[False], [True]]
    assert not stepped["next", "truncated"].any()
    assert stepped["next", "privileged", "extrinsic"][1, 13] > 0.5  # still beyond the deck's edge
    assert following["privileged", "extrinsic"][1, 13].abs() < 0.1
    assert stepped["next", "reward_terms", "termination"].flatten().tolist() == pytest.approx([0.0, -0.2])


@pytest.mark.parametrize("retry", [0.0, 1.0])
def test_a_robot_that_fell_tries_again_with_its_intrinsics(retry):
    env = make(3, failed_episode_replay=retry)
    td = env.reset()
    before = td["privileged", "intrinsic"].clone()
    env.engine.qpos[1, env.scene.layout.root_qpos] += 1.0  # off the deck
    td["action"] = torch.zeros(3, 12)
    stepped, following = env.step_and_maybe_reset(td)
    assert stepped["next", "terminated"].flatten().tolist() == [False, True, False]
    kept = (following["privileged", "intrinsic"] == before).all(-1)
    assert kept.tolist() == [True, retry == 1.0, True]
    fresh = env.reset()["privileged", "intrinsic"]  # nobody has fallen since
    assert not (fresh == before).all(-1).any()


def test_same_seed_same_episodes_other_seed_others():
    def episodes(seed: int) -> TensorDictBase:
        env, generator = make(3, seed=seed), torch.Generator().manual_seed(0)
        return torch.stack([env.reset(), *(env.step(act(env, generator))["next"] for _ in range(4))][1:])

    first, again, other = episodes(7), episodes(7), episodes(8)
    assert (first == again).all()
    assert not torch.equal(first["privileged", "intrinsic"], other["privileged", "intrinsic"])
    env = make(3)
    env.set_seed(7)
    one = env.reset()
    env.set_seed(7)
    assert torch.equal(one["observation"], env.reset()["observation"])


def test_state_round_trip_continues_bit_for_bit():
    env, generator = make(3, pushes=False), torch.Generator().manual_seed(0)
    env.reset()
    for _ in range(10):
        env.step(act(env, generator))
    state, actions = env.get_state(), [act(env, generator) for _ in range(10)]
    one = torch.stack([env.step(action.clone())["next"] for action in actions])
    other = make(3, seed=5, pushes=False)
    other.set_state(state)
    two = torch.stack([other.step(action.clone())["next"] for action in actions])
    assert (one == two).all()


def test_a_state_that_does_not_fit_is_named():
    env = make(2)
    with pytest.raises(ValueError, match=r"the state is of \(3,\) robots; this env has \(2,\)"):
        env.set_state(make(3).get_state())
    with pytest.raises(KeyError, match="the state lacks 'speeds'"):
        env.set_state(env.get_state().exclude("speeds"))
    with pytest.raises(ValueError, match="state entry 'x_int'"):
        env.set_state(env.get_state().set("x_int", torch.zeros(2, 3)))


def test_commands_are_scored_and_echoed_and_zero_without_one():
    env = make(2)
    td = env.reset()
    assert (td["command"] == 0).all()
    td["action"], td["command"] = torch.zeros(2, 12), torch.tensor([[0.0, 0.0], [1.0, -0.5]])
    following = env.step(td)["next"]
    assert torch.equal(following["command"], td["command"])
    assert torch.equal(following["observation"][:, -2:], td["command"])
    expected = 0.02 * 8.0 * torch.exp(-(following["speeds"] - td["command"]).abs() / 0.5)
    torch.testing.assert_close(following["reward_terms", "forward_command"], expected[:, :1])
    torch.testing.assert_close(following["reward_terms", "steering_command"], expected[:, 1:])


def test_actions_displace_the_joints_from_q0():
    env = make(1)
    td = env.reset()
    td["action"] = torch.linspace(-1, 1, 12).unsqueeze(0)
    env.step(td)
    expected = np.array(env.scene.robot.q0) + 0.25 * np.linspace(-1, 1, 12)
    np.testing.assert_allclose(env.engine.ctrl[0, env.scene.layout.actuators], expected, atol=1e-6)


def test_an_action_buffer_that_is_written_again_does_not_rewrite_the_past():
    env = make(1, pushes=False)
    td = env.reset()
    buffer = torch.full((1, 12), 0.5)
    env.step(td.clone().set("action", buffer))
    buffer.fill_(-0.5)
    following = env.step(td.clone().set("action", buffer))["next"]
    assert following["reward_terms", "action_smoothness"].item() == pytest.approx(-0.02 * 1e-5 * 12**0.5, rel=1e-4)
    assert (following["proprio"][:, -12:] == -0.5).all()


def test_what_users_change_in_place_stays_outside():
    env, twin = make(3), make(3)
    td, other = env.reset(), twin.reset()
    for _ in range(3):
        for value in td.exclude("command").values(True, True):  # the command goes in again
            value.zero_()
        other = twin.step(other.set("action", torch.zeros(3, 12)))["next"].exclude("reward")
        td = env.step(td.set("action", torch.zeros(3, 12)))["next"].exclude("reward")
        assert (td == other).all()
    td.zero_()
    assert (env.get_state() == twin.get_state()).all()


def test_pushes_come_every_three_seconds():
    env = make(2, randomization="off")
    td = env.reset()
    env.runner.steps[:] = torch.tensor([149, 0])
    td["action"] = torch.zeros(2, 12)
    kicked = []
    for _ in range(3):
        before = env.engine.hook.speeds.clone()
        env.step(td)
        kicked.append(((env.engine.hook.speeds - before).abs().amax(-1) > 0.05).tolist())
    assert kicked == [[False, False], [True, False], [False, False]]


def test_pushes_are_bounded_and_reach_robot_and_platform():
    env = make(64)
    velocity, speeds = env.engine.qvel.clone(), env.engine.hook.speeds.clone()
    env.runner.steps[:] = 150
    env.runner.apply_action(torch.zeros(64, 12))
    robot, platform = (env.engine.qvel - velocity).numpy(), (env.engine.hook.speeds - speeds).numpy()
    root = env.scene.layout.root_dof
    assert 0.4 < np.abs(robot[:, root : root + 2]).max() <= 0.5
    assert 0.4 < np.abs(platform[:, 0]).max() <= 0.5
    assert 0.2 < np.abs(platform[:, 1]).max() <= 0.25
    assert np.abs(np.delete(robot, [root, root + 1], axis=1)).max() == 0.0
    assert (np.abs(platform).min(-1) > 0).all()


class TestDivergence:
    def trajectory(self, env: RidingEnv, bad: dict[int, float]) -> list[TensorDictBase]:
        """Steps with zero actions; before step t the velocity of row 2 is set to ``bad[t]``."""
        td, kept = env.reset(), []
        action = TensorDict({"action": torch.zeros(4, 12)}, [4])
        for step in range(6):
            if step in bad:
                env.engine.qvel[2, 8] = bad[step]
            kept.append(env.step(action.clone())["next"])
            if kept[-1]["done"].any():
                td = reset(env, kept[-1]["done"], kept[-1].exclude("reward"))
        assert torch.isfinite(td["observation"]).all()
        return kept

    def test_it_ends_its_own_episode_and_no_other_notices(self):
        calm, wild = make(pushes=False), make(pushes=False)
        quiet = torch.stack(self.trajectory(calm, {}))
        # twice in a row: each time just after the reset that followed
        loud = torch.stack(self.trajectory(wild, {2: 1e13, 3: np.nan}))
        assert (quiet[:, [0, 1, 3]] == loud[:, [0, 1, 3]]).all()
        assert loud["terminated"][:, 2, 0].tolist() == [False, False, True, True, False, False]
        assert (wild.num_diverged, calm.num_diverged) == (2, 0)
        for key in loud.keys(True, True):
            assert torch.isfinite(loud[key].float()).all(), key

    def test_it_is_seen_again_without_a_reset_between(self):
        env = make()
        for _ in range(3):  # MuJoCo's own count of warnings stays at one
            env.engine.qvel[2, 8] = 1e13
            env.engine.step(torch.tensor([env.scene.robot.q0] * 4))
            assert env.engine.diverged.tolist() == [False, False, True, False]
        env.engine.step(torch.tensor([env.scene.robot.q0] * 4))
        assert not env.engine.diverged.any()

    @pytest.mark.parametrize("value", [1e13, np.nan])
    def test_dm_control_survives_it_twice(self, value):
        env = make(1, physics="dm_control")
        for count in (1, 2):
            td = env.reset()
            env.engine.qvel[0, 8] = value
            following = env.step(td.set("action", torch.zeros(1, 12)))["next"]
            assert following["terminated"].all()
            assert torch.isfinite(following["observation"]).all()
            assert torch.isfinite(following["reward"]).all()
            assert env.num_diverged == count
        td = env.reset()
        assert not env.step(td.set("action", torch.zeros(1, 12)))["next", "done"].any()

    def test_a_simulation_that_raises_counts_as_diverged(self, monkeypatch):
        env = make(2)
        step = env.engine.batch.step

        def failing(ids: np.ndarray | None = None, **kwargs: object) -> None:
            step(np.array([0]), **kwargs)  # what MuJoCo does: the others run, the failed one stays
            raise SimulationError(np.array([1]), "out of memory")

        monkeypatch.setattr(env.engine.batch, "step", failing)
        env.engine.step(torch.tensor([env.scene.robot.q0] * 2))
        assert env.engine.diverged.tolist() == [False, True]


class TestBadInput:
    def test_actions_that_are_not_finite(self):
        env = make()
        action = torch.zeros(4, 12)
        action[2, 5] = torch.nan
        with pytest.raises(ValueError, match=r"'action' is not finite for env ids \[2\]"):
            env.step(env.reset().set("action", action))

    def test_actions_of_the_wrong_shape(self):
        env = make(4)
        with pytest.raises(ValueError, match=r"'action' has shape \(4, 11\); this env needs \(4, 12\)"):
            env.runner.apply_action(torch.zeros(4, 11))

    def test_commands_of_the_wrong_shape(self):
        env = make(4)
        td = env.reset().set("action", torch.zeros(4, 12)).set("command", torch.zeros(4, 3))
        with pytest.raises(ValueError, match=r"'command' has shape \(4, 3\); this env needs \(4, 2\)"):
            env.step(td)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"robot": "cat"}, "unknown robot 'cat'; known: a1"),
            ({"transporter": "sledge"}, "unknown transporter 'sledge'; known: single_board"),
            ({"profile": "wild"}, "unknown profile 'wild'; known: default, paper, literal"),
            ({"randomization": "all"}, "unknown randomization 'all'; choose one of train, test, off"),
            ({"physics": "warp"}, "unknown physics 'warp'; choose 'batch' or 'dm_control'"),
            ({"physics": "dm_control", "num_envs": 2}, "num_envs=2 needs physics='batch'"),
            ({"num_envs": 0}, "num_envs=0: choose a whole number"),
            ({"num_envs": 1.5}, "num_envs=1.5: choose a whole number"),
            ({"num_threads": 0}, "num_threads=0: choose"),
        ],
    )
    def test_arguments(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            make(**{"num_envs": 1, **arguments})


def test_the_task_runs_without_torchrl():
    env = make(2)
    runner = EpisodeRunner(env.task, env.engine, "train", torch.Generator())
    runner.apply_action(torch.zeros(2, 12))
    env.engine.advance(4)
    outcome = runner.evaluate_step(torch.zeros(2, 2))
    assert outcome.reward.shape == (2, 1)
    assert outcome.terminated.shape == (2,)


def test_moving_starts_share_the_commanded_speeds_with_robot_and_board():
    env = RidingEnv(num_envs=64, num_threads=1, moving_start=1.0, seed=0)
    command = torch.tensor([[1.5, -0.8]]).expand(64, 2).clone()
    td = env.reset(TensorDict({"command": command}, [64]))
    speeds = td["speeds"]
    assert bool((speeds[:, 0] >= 0).all() & (speeds[:, 0] <= 1.5).all())
    assert bool((speeds[:, 1] <= 0).all() & (speeds[:, 1] >= -0.8).all())
    assert speeds.std(0).min() > 0.1
    # body and platform move as one: same velocity at the pivot, same yaw rate
    extrinsic = td["privileged", "extrinsic"]
    body, platform, turning = extrinsic[:, 4:7], extrinsic[:, 7:10], extrinsic[:, 10:13]
    assert torch.allclose(turning[:, 2], speeds[:, 1], atol=2e-2)
    assert (body - platform).norm(dim=-1).max() < 0.8 * 0.02
    at_rest = RidingEnv(num_envs=4, num_threads=1, seed=0).reset(TensorDict({"command": command[:4]}, [4]))
    assert torch.equal(at_rest["speeds"], torch.zeros(4, 2))

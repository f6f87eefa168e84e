"""Every task of the package, for every robot (on every transporter), held to one standard; one robot on dm_control."""

from __future__ import annotations

import copy
import inspect
import itertools
import pickle

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from torchrl_atr.envs import ROBOTS, QuadrupedEnv, RidingEnv
from torchrl_atr.envs.models import TRANSPORTER_DESIGNS
from torchrl_atr.envs.tasks import TASKS, StepContext, make_task

OURS = [name for name in TASKS.names() if TASKS.get(name).__module__.startswith("torchrl_atr.")]
"""Tests of other files register tasks of their own."""
PARTS = {"robot": ROBOTS.names(), "transporter": tuple(TRANSPORTER_DESIGNS)}
STEPS = 500
ON_DM_CONTROL = "a1"
"""Of other robots dm_control steps the same model as the batch engine: test_engine.py compares them."""


def cases() -> list[tuple[str, dict[str, str], str]]:
    """Tasks with every combination of the robots and transporters that they take, and an engine."""
    found = []
    for name in OURS:
        taken = [part for part in PARTS if part in inspect.signature(TASKS.get(name)).parameters]
        for values in itertools.product(*(PARTS[part] for part in taken)):
            parts = dict(zip(taken, values, strict=True))
            engines = ["batch"] + ["dm_control"] * (ON_DM_CONTROL in values)
            found += [(name, parts, engine) for engine in engines]
    return found


@pytest.fixture(scope="module", params=cases(), ids=lambda case: "-".join([case[0], *case[1].values(), case[2]]))
def make(request):
    """``make(seed)``: an env of a case; one robot on dm_control, three on the batch engine."""
    name, parts, physics = request.param
    if physics == "dm_control":
        pytest.importorskip("dm_control")

    def build(seed: int = 0) -> QuadrupedEnv:
        num_envs = 1 if physics == "dm_control" else 3
        return QuadrupedEnv(make_task(name, **parts), num_envs, physics, seed=seed, num_threads=1)

    return build


@pytest.fixture(scope="module")
def env(make) -> QuadrupedEnv:
    """Shared; tests begin it anew."""
    return make()


def run(env: QuadrupedEnv, td: TensorDict, steps: int) -> TensorDict:
    """What random actions under a command of half the bounds lead to; fallen robots go on."""
    generator, taken = torch.Generator().manual_seed(1), []
    command = 0.5 * torch.tensor(env.task.command.grid.bounds).expand(*env.batch_size, -1)
    for _ in range(steps):
        td["action"] = torch.randn(env.action_spec.shape, generator=generator)
        td, following = env.step_and_maybe_reset(td.set("command", command))
        taken.append(td["next"])
        td = following
    return torch.stack(taken, 1)


def rest(env: QuadrupedEnv) -> TensorDict:
    """From where the env is now."""
    return TensorDict({}, batch_size=env.batch_size)


def differing(one: TensorDict, other: TensorDict) -> list[object]:
    """Entries that are not the same, bit for bit."""
    return [key for key in one.keys(True, True) if not torch.equal(one[key], other[key])]


def test_specs(env):
    check_env_specs(env)


def test_same_seed_same_rollout(make):
    first, second = (run(env, env.reset(), 30) for env in (make(seed=3), make(seed=3)))
    assert differing(first, second) == []


def test_random_actions_stay_finite_move_every_observation_and_name_every_term(env):
    failed = env.num_diverged
    data = run(env, env.reset(), STEPS)
    assert env.num_diverged == failed
    for key in data.keys(True, True):
        assert data[key].isfinite().all(), key
    for key in env.task.observations:
        spread = data[key].flatten(0, 1).std(0)
        assert (spread > 0).all(), (key, (spread == 0).nonzero().squeeze(-1).tolist())
    assert set(data["reward_terms"].keys()) == set(env.task.rewards)
    total = torch.stack(list(data["reward_terms"].values())).sum(0)
    torch.testing.assert_close(total, data["reward"])


def test_every_episode_starts_standing_on_what_carries_it(env):
    """Intrinsics in their training range, the robot upright and, on a deck, inside it."""
    for _ in range(3):
        td = env.reset()
        assert (td["privileged", "intrinsic"].abs() <= 1.0 + 1e-6).all()
        if env.task.support.size is not None:
            relative = td["privileged", "extrinsic"][:, 13:15].abs()
            assert (relative < torch.tensor(env.task.support.size) / 2).all()
        reading = env.runner.observe(torch.zeros(*env.batch_size, 2))
        state = env.runner.terms.extractor.read()
        context = StepContext(state, *[td["command"]] * 3, None, env.scene, env.task.interpretation)
        assert not [name for name, ends in env.task.terminations.items() if ends(context).any()]
        assert (reading["proprio"][:, 6:8].abs() < 0.1).all()  # roll and pitch
        height = state.position[:, 2] - env.task.support.height
        assert ((height - env.task.robot.standing_height).abs() < 0.05).all()


def test_a_partial_reset_touches_only_its_rows(env):
    last = run(env, env.reset(), 10)[:, -1].exclude("reward")
    chosen = torch.arange(len(last)) == 1  # of one robot alone: none
    before = env.get_state()
    env.reset(last.set("_reset", chosen.unsqueeze(-1)))
    after = env.get_state()
    for name in before.keys(True, True):
        assert torch.equal(after[name][~chosen], before[name][~chosen]), name
    assert not (after["x_int"] == before["x_int"])[chosen].all(-1).any()
    assert (after["qvel"][chosen] == 0).all()
    assert (after["previous_action"][chosen] == 0).all()


@pytest.mark.parametrize(
    "duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"]
)
def test_copies_go_on_bit_for_bit(env, duplicate):
    run(env, env.reset(), 5)
    other = duplicate(env)
    assert differing(run(env, rest(env), 6), run(other, rest(env), 6)) == []


def test_a_state_is_restored_bit_for_bit(env):
    run(env, env.reset(), 5)
    state, draws = env.get_state(), env.rng.get_state()
    one = run(env, rest(env), 6)
    env.set_state(state)
    env.rng.set_state(draws)
    assert differing(env.get_state(), state) == []
    assert differing(run(env, rest(env), 6), one) == []


def test_mirror_images_are_signed_permutations_that_undo_themselves(env):
    images = env.reflections
    assert set(images) >= {*env.task.observations, "command", "observation", ("privileged", "intrinsic"), "action"}
    for key, matrix in images.items():
        spec = env.action_spec if key == "action" else env.observation_spec[key]
        assert spec.shape[-1] == len(matrix), key
        assert torch.equal(matrix @ matrix, torch.eye(len(matrix))), key
        for axis in (0, 1):
            assert ((matrix != 0).sum(axis) == 1).all(), key


@pytest.mark.parametrize("robot", ["a1", "go1"])
def test_a_standing_g1_robot_with_its_mass_centred_survives_on_the_single_board(robot):
    """Zero action, no pushes, Table II's training range with the trunk's CoM centred: 5 s, at least 80 % of draws."""
    env = RidingEnv(robot, "single_board", num_envs=128, pushes=False, seed=0)
    state = env.get_state()
    centred = state["x_int"].clone()
    centred[:, 1:4] = 0.0
    state["x_int"] = centred
    env.set_state(state)
    td = TensorDict({"action": torch.zeros(128, 12)}, [128])
    up = torch.ones(128, dtype=torch.bool)
    for _ in range(250):
        up &= ~env.step(td)["next", "terminated"].squeeze(-1)
    assert up.float().mean() >= 0.8

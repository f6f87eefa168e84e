"""What users of TorchRL expect of any env: bounded actions, seeds, copies, modes and dtypes that do not matter."""

from __future__ import annotations

import copy
import dataclasses
import json
import pickle
import subprocess
import sys

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Unbounded
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, TransformedEnv
from torchrl.modules import TanhNormal

from torchrl_atr._errors import InputError
from torchrl_atr.config import ComputeConfig, ConfigError, EnvConfig, PPOConfig, TrainConfig
from torchrl_atr.envs import RidingEnv, make_riding_env
from torchrl_atr.envs.transforms import (
    CommandCurriculum,
    CommandGrid,
    CompactStorage,
    ObservationHistory,
    OverspeedTermination,
    RandomizedStepCounter,
    task_transforms,
)
from torchrl_atr.modules import make_networks
from torchrl_atr.training import make_config

TRAINING = {
    "stagger": 5,
    "failed_episode_replay": 0.5,
    "moving_start": 0.5,
    "overspeed_margin": (2.0, 2.0),
    "max_steps": 20,
    "window": 15,
}


def make(**options: object) -> TransformedEnv:
    return make_riding_env(**{"num_envs": 3, "seed": 0, "num_threads": 1, **options})


def ride(env: EnvBase, root: TensorDictBase, steps: int, seed: int = 1) -> tuple[TensorDict, TensorDictBase]:
    """Steps under random actions, and the root of the one after them; who is done begins anew."""
    generator, kept = torch.Generator().manual_seed(seed), []
    for _ in range(steps):
        action = 0.5 * torch.randn(env.action_spec.shape, generator=generator, dtype=torch.float32)
        step, root = env.step_and_maybe_reset(root.clone().set("action", action))
        kept.append(step["next"].clone())
    return torch.stack(kept, 1), root


def test_the_action_spec_is_bounded_around_the_stand():
    env = make()
    assert isinstance(env.action_spec, Bounded)
    low, high = env.action_spec.space.low, env.action_spec.space.high
    assert torch.equal(low, -high)
    assert (high == 3.0).all()
    policy = TanhNormal(torch.zeros(3, 12), torch.ones(3, 12), low=low, high=high)
    assert torch.isfinite(policy.log_prob(policy.sample())).all()
    assert torch.allclose(policy.deterministic_sample, torch.zeros(3, 12))
    assert env.action_spec.rand().abs().max() <= 3.0


def test_actions_beyond_the_spec_are_carried_out_up_to_the_joints_ranges():
    env = RidingEnv(num_envs=1, num_threads=1, seed=0)
    env.step(env.reset().set("action", torch.full((1, 12), 5.0)))
    targets = env.engine.ctrl[0, env.scene.layout.actuators]
    assert torch.allclose(targets, torch.tensor(env.scene.robot.q0).double() + 0.25 * 5.0)


@pytest.mark.parametrize("bounded", [True, False])
def test_networks_take_any_action_spec(bounded):
    env = make()
    spec = env.action_spec if bounded else Unbounded((3, 12))
    networks = make_networks(env.observation_spec, spec, actor_cells=[8], critic_cells=[8])
    assert networks.deployed_policy()(env.reset())["action"].shape == (3, 12)


@pytest.mark.parametrize(
    "build",
    [
        lambda: make(**TRAINING),
        lambda: make(seed=None, **TRAINING),
        lambda: TransformedEnv(RidingEnv(num_envs=3, num_threads=1), CommandCurriculum((0.16, 0.16))),
        lambda: SerialEnv(2, lambda: make(num_envs=2)),
        lambda: TransformedEnv(
            SerialEnv(2, lambda: RidingEnv(num_envs=2, num_threads=1)), CommandCurriculum((0.16, 0.16))
        ),
    ],
    ids=["make", "unseeded", "composed", "serial", "around-serial"],
)
def test_a_seed_fixes_commands_and_intrinsics(build):
    env = build()

    def start(seed: int) -> TensorDictBase:
        env.set_seed(seed)
        return env.reset().clone()

    first, moved, again, other = start(3), env.rand_step(env.reset()), start(3), start(4)
    for key in ("command", ("privileged", "intrinsic")):
        assert torch.equal(first[key], again[key]), key
        assert not torch.equal(first[key], other[key]), key
        assert moved["next", key].shape == first[key].shape
        copies = first[key].flatten(0, -2)
        assert len(copies.unique(dim=0)) == len(copies)  # nor are two robots, or two copies of an env, alike
    env.close()


def test_parallel_copies_differ_and_follow_their_seeds():
    env = ParallelEnv(2, lambda: make(num_envs=1, seed=0))
    try:
        env.set_seed(3)
        first = env.reset().clone()
        env.set_seed(3)
        again = env.reset().clone()
        for key in ("command", ("privileged", "intrinsic")):
            assert torch.equal(first[key], again[key])
            assert not torch.equal(first[key][0], first[key][1])
    finally:
        env.close()


def test_a_transforms_own_seed_after_the_envs_counts():
    env, other = make(), make()
    env.set_seed(3)
    env.curriculum.set_seed(5)
    other.curriculum.set_seed(5)
    other.set_seed(4)
    other.curriculum.set_seed(5)
    assert torch.equal(env.reset()["command"], other.reset()["command"])


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize(
    "build",
    [
        lambda: make(**TRAINING),
        lambda: RidingEnv(num_envs=2, seed=0, num_threads=1, failed_episode_replay=0.5),
        lambda: make(num_envs=1, physics="dm_control", max_steps=20, window=15),
    ],
    ids=["make", "bare", "dm_control"],
)
def test_copies_ride_on_bit_for_bit(build, duplicate):
    env = build()
    _, root = ride(env, env.reset(), 25)
    other = duplicate(env)
    there, _ = ride(other, root, 30, seed=2)
    here, _ = ride(env, root, 30, seed=2)
    assert here["done"].any()  # new episodes too
    assert (here == there).all()
    assert not torch.equal(env.reset()["observation"], here["observation"][:, -1])


@pytest.mark.parametrize("build", [lambda **o: RidingEnv(**{"num_envs": 3, "seed": 0, "num_threads": 1, **o}), make])
def test_a_rollout_in_inference_mode_changes_nothing_for_later_ones(build):
    options = {} if build is not make else TRAINING

    def rides(inference: bool) -> TensorDict:
        env = build(**options)
        data, root = ride(env, env.reset(), 10)
        with torch.inference_mode(inference):
            _, root = ride(env, root, 22)
            base = env.base_env if isinstance(env, TransformedEnv) else env
            base.set_state(base.get_state())
        data, root = ride(env, root, 22)
        for key, value in data.items(True, True):
            assert not value.is_inference(), key
        (torch.ones((), requires_grad=True) * env.reset()["observation"]).sum().backward()
        return data

    assert (rides(True) == rides(False)).all()


def test_an_env_made_in_inference_mode_works_outside_and_pins_set_in_it_hold():
    with torch.inference_mode():
        env = make(**TRAINING)
        env.rollout(2)
        env.curriculum.pin([0.25, 0.0])
        env.curriculum.merge_(torch.ones(env.curriculum.grid.shape))
    assert env.curriculum.frontier == env.curriculum.grid.bounds
    env.rollout(30, break_when_any_done=False)
    assert (env.reset()["command"] == torch.tensor([0.25, 0.0])).all()


_RIDE = """
import sys, torch
torch.set_default_dtype(getattr(torch, sys.argv[1]))
from torchrl_atr.envs import make_riding_env
from torchrl_atr.modules import Exploration, hadamard_leg_basis, make_networks
torch.manual_seed(0)
env = make_riding_env(num_envs=3, seed=0, num_threads=1, max_steps=20, window=15, stagger=5, failed_episode_replay=0.5,
                      moving_start=0.5, overspeed_margin=(2.0, 2.0))
action, root, total = torch.full((3, 12), 0.3, dtype=torch.float32), env.reset(), 0.0
for _ in range(60):
    step, root = env.step_and_maybe_reset(root.set("action", action))
    assert all(value.dtype != torch.float64 for value in step.values(True, True))
    total += step["next", "observation"].double().sum().item() + step["next", "reward"].double().sum().item()
assert env.observation_spec["observation"].dtype == torch.float32
assert all(value.dtype == torch.float32 for value in env.base_env.reflections.values())
networks = make_networks(env.observation_spec, env.action_spec, reflections=env.base_env.reflections,
                         exploration=Exploration(12, basis=hadamard_leg_basis()), output_map=hadamard_leg_basis().T)
assert env.rollout(2, networks.rollout_policy("mixed"))["action"].dtype == torch.float32
print(repr(total))
"""


def test_the_default_dtype_changes_nothing():
    totals = [
        subprocess.run([sys.executable, "-c", _RIDE, dtype], capture_output=True, text=True, check=True).stdout
        for dtype in ("float32", "float64")
    ]
    assert totals[0] == totals[1]


@pytest.mark.parametrize(("key", "size"), [("command", 2), ("action", 12)])
def test_what_float32_cannot_hold_is_refused_like_an_infinity(key, size):
    env = RidingEnv(num_envs=2, seed=0, num_threads=1)
    root = env.reset().set("action", torch.zeros(2, 12))
    value = torch.zeros(2, size, dtype=torch.float64)
    value[1, 0] = 1e300
    with pytest.raises(InputError, match=rf"'{key}' is not finite for env ids \[1\]"):
        env.step(root.clone().set(key, value))
    assert env.num_diverged == 0
    with pytest.raises(InputError, match=f"'{key}' holds complex numbers"):
        env.step(root.clone().set(key, torch.zeros(2, size, dtype=torch.complex64)))
    whole = env.step(root.clone().set(key, torch.ones(2, size, dtype=torch.long)))["next"]
    assert whole[key if key == "command" else "proprio"].dtype == torch.float32


def test_a_state_that_is_not_finite_in_float32_is_refused():
    env = RidingEnv(num_envs=2, seed=0, num_threads=1)
    for name in ("x_int", "dead_reckoned_velocity"):
        state = env.get_state()
        with pytest.raises(InputError, match=f"'{name}' is not finite in float32"):
            env.set_state(state.set(name, torch.full_like(state[name], 1e300, dtype=torch.float64)))
    state = env.get_state()
    with pytest.raises(InputError, match="'qpos' is not finite for env id 0"):
        env.set_state(state.set("qpos", torch.full_like(state["qpos"], torch.inf)))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pushes", 2.0),
        ("pushes", None),
        ("compiled", 1),
        ("num_threads", 2.5),
        ("num_threads", True),
        ("failed_episode_replay", "x"),
        ("failed_episode_replay", True),
        ("moving_start", True),
        ("moving_start", float("nan")),
        ("seed", 1.5),
        ("seed", True),
        ("seed", -1),
        ("num_envs", True),
        ("num_envs", "4"),
        ("physics", None),
        ("randomization", 3),
        ("profile", []),
        ("robot", None),
        ("transporter", []),
        ("dump_dir", True),
    ],
)
def test_wrong_kinds_of_arguments_are_named(name, value):
    for build in (RidingEnv, make_riding_env):
        with pytest.raises(ValueError, match=name):
            build(**{"num_envs": 1, "num_threads": 1, name: value})


@pytest.mark.parametrize(
    ("provoke", "name"),
    [
        (lambda: task_transforms((0.2, 0.2), max_steps=10.5), "max_steps=10.5"),
        (lambda: task_transforms((0.2, 0.2), stagger=True), "stagger=True"),
        (lambda: task_transforms((0.2, 0.2), compact_storage=1), "compact_storage=1"),
        (lambda: CommandCurriculum(0.2), "tracking_max=0.2"),
        (lambda: CommandCurriculum((0.2, 0.2), thresholds=("a", "b")), "thresholds='a'"),
        (lambda: CommandCurriculum((0.2, 0.2), window=2.5), "window=2.5"),
        (lambda: CommandCurriculum((0.2, 0.2), seed=1.5), "seed=1.5"),
        (lambda: CommandCurriculum((0.2, 0.2), grid=3), "grid=3"),
        (lambda: CommandCurriculum((0.2, 0.2), seed=0).set_seed("x"), "seed='x'"),
        (lambda: CommandGrid(bounds=3.0), "bounds must be"),
        (lambda: CommandGrid(increment=True), "increment=True"),
        (lambda: CommandGrid(count_own_twice=2.0), "count_own_twice=2.0"),
        (lambda: ObservationHistory(2.5), "length=2.5"),
        (lambda: ObservationHistory(2, include_current=1), "include_current=1"),
        (lambda: OverspeedTermination(CommandCurriculum((0.2, 0.2)), margin=3.0), "margin must be two positive"),
        (lambda: OverspeedTermination(None), "curriculum=None"),
        (lambda: RandomizedStepCounter(5.5), "max_steps=5.5"),
        (lambda: RandomizedStepCounter(10**400), "max_steps=1000"),
        (lambda: CommandGrid(increment=10**400), "increment=1000"),
        (lambda: CommandCurriculum((True, 0.2)), "tracking_max=True"),
        (lambda: CommandCurriculum(torch.tensor(0.2)), "tracking_max="),
        (lambda: CommandCurriculum((0.2, 0.2), tracking_keys=(1, 2)), "tracking_keys=1"),
        (lambda: CommandCurriculum((0.2, 0.2), unscored_key=(1, 2)), "unscored_key="),
        (lambda: CommandCurriculum((0.2, 0.2), command_key=()), "command_key="),
        (lambda: OverspeedTermination(CommandCurriculum((0.2, 0.2)), speeds_key=None), "speeds_key=None"),
        (lambda: OverspeedTermination(CommandCurriculum((0.2, 0.2)), reward_keys=(1,)), "reward_keys=1"),
        (lambda: ObservationHistory(2, out_key=("a", 1)), "out_key="),
        (lambda: CompactStorage(in_next=(1,)), "in_next=1"),
        (lambda: make(history_length=2.5), "history_length=2.5"),
        (lambda: make(overspeed_margin=2.0), "overspeed_margin must be"),
        (lambda: make(num_threads=10**400), "num_threads=1000"),
        (lambda: make(transporter={}), "there is no name, design"),
        (lambda: make(transporter={"disc": 1}), "unknown key 'disc'"),
        (lambda: RandomizedStepCounter(5, check_interval=2.5), "check_interval=2.5"),
        (lambda: CompactStorage(at_root="history"), "at_root='history'"),
    ],
)
def test_wrong_kinds_of_the_transforms_arguments_are_named(provoke, name):
    with pytest.raises(ValueError, match=name):
        provoke()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("latent_features", 0),
        ("latent_features", 2.5),
        ("actor_cells", "x"),
        ("critic_cells", (8, True)),
        ("privileged_critic", 1),
        ("estimator_kwargs", 3),
        ("reflections", 3),
        ("estimator_inputs", "dead_reckoned_velocity"),
        ("critic_inputs", 3),
        ("exploration", 0.3),
        ("output_map", 2.0),
        ("keys", "observation"),
        ("action_spec", None),
        ("observation_spec", {}),
    ],
)
def test_wrong_kinds_of_the_networks_arguments_are_named(name, value):
    env = make()
    specs = {"observation_spec": env.observation_spec, "action_spec": env.action_spec}
    with pytest.raises(InputError, match="spec" if "spec" in name else name):
        make_networks(**{**specs, name: value})


def test_tracking_limits_may_be_a_tensor():
    assert CommandCurriculum(torch.tensor([0.25, 0.5]))._required.tolist() == [50.0, 100.0]


def test_numbers_of_numpy_are_settings_too():
    env, ppo = EnvConfig(num_envs=np.int64(4)), PPOConfig(gamma=np.float32(0.5), critic_cells=(np.int64(8),))
    config = TrainConfig(env=env, ppo=ppo, compute=ComputeConfig(compiled=np.bool_(False)))
    assert json.loads(json.dumps(dataclasses.asdict(config)))["env"]["num_envs"] == 4
    assert config == make_config({"env.num_envs": 4, "ppo.gamma": 0.5, "ppo.critic_cells": (8,)})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("compute.compiled", 1.0),
        ("ppo.symmetric", 0),
        ("env.num_envs", 2.5),
        ("env.num_envs", True),
        ("ppo.gamma", True),
        ("ppo.gamma", "0.9"),
        ("task.robot", 3),
        ("imports", "module"),
        ("ppo.critic_cells", (8.5,)),
    ],
)
def test_wrong_kinds_of_settings_are_named(name, value):
    with pytest.raises(ConfigError, match=name):
        make_config({name: value})

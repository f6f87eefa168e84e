"""Contenders of this library, from bare physics to the training collector, to measure the cost of each layer."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

import mujoco
import mujoco.batch
import torch
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType

from benchmarks.timing import Contender, Key
from torchrl_atr.envs import RidingEnv, get_robot, get_transporter, make_riding_env
from torchrl_atr.envs.models import Scene, Transporter, build_scene
from torchrl_atr.envs.models.scene import STAND
from torchrl_atr.envs.physics.engine import DECIMATION
from torchrl_atr.training import TrainConfig, make_config, make_env, make_policy, make_run_networks
from torchrl_atr.training.collection import Collection

STAND_STEPS = 100
"""Control steps after which the robots of the physics limit are reset: without a policy they fall after some 10 s."""


def standing_step(scene: Scene, num_envs: int, threads: int) -> Callable[[], mujoco.batch.Batch]:
    """Return a function that advances N standing robots (keyframe ``stand``, ctrl = q0) by one control step."""
    batch = mujoco.batch.Batch(scene.model, num_envs, nthread=threads)
    steps, stand = itertools.count(), scene.model.key(STAND).id

    def step() -> mujoco.batch.Batch:
        if next(steps) % STAND_STEPS == 0:
            batch.reset(keyframe=stand, stage=mujoco.mjtStage.mjSTAGE_NONE)
        batch.step(nstep=DECIMATION)
        return batch

    return step


def physics(num_envs: int, threads: int) -> Contender:
    """Return the physics limit: ``mujoco.batch`` on our scene with standing robots."""
    robot = get_robot("a1")
    scene = build_scene(robot, Transporter(get_transporter("single_board", robot)))
    stand = standing_step(scene, num_envs, threads)

    def step() -> int:
        stand()
        return num_envs

    return Contender(Key("physics", num_envs, threads), step)


def stepped(name: str, env: EnvBase, threads: int) -> Contender:
    """Return a contender that steps an env with zero actions by ``step_and_maybe_reset``, and closes it."""
    size = env.batch_size.numel()
    still, state = env.full_action_spec.zero(), env.reset()

    def step() -> int:
        nonlocal state
        _, state = env.step_and_maybe_reset(state.update(still))
        return size

    return Contender(Key(name, size, threads), step, env.close)


def bare(num_envs: int, threads: int, compiled: bool = False, name: str = "bare") -> Contender:
    """Return ``RidingEnv`` alone."""
    return stepped(name, RidingEnv(num_envs=num_envs, num_threads=threads, seed=0, compiled=compiled), threads)


def transformed(num_envs: int, threads: int, compiled: bool = False) -> Contender:
    """Return ``make_riding_env``: with command curriculum, history, time limit."""
    return stepped("transformed", _riding_env(num_envs, threads, compiled), threads)


def free(num_envs: int, threads: int, steps: int, compiled: bool = False, name: str = "free") -> Contender:
    """Return TorchRL's ``Collector`` with a policy that costs nothing; ``steps`` control steps per batch."""
    env = _riding_env(num_envs, threads, compiled, compact_storage=True)
    still = env.full_action_spec.zero()
    return _collected(name, env, lambda state: state.update(still), threads, steps)


def deployed(num_envs: int, threads: int, steps: int, compiled: bool = False) -> Contender:
    """Return ``Collector`` with the deployed policy, untrained: estimators and actor."""
    env = _riding_env(num_envs, threads, compiled, compact_storage=True)
    torch.manual_seed(0)
    policy = make_run_networks(TrainConfig(), env).deployed_policy()
    return _collected("deployed", env, policy, threads, steps)


def training_policy(num_envs: int, threads: int, steps: int, compiled: bool = False) -> Contender:
    """Return the trainer's collection: its env and its untrained policy, with exploration."""
    sizes = {"env.num_envs": num_envs, "ppo.rollout_steps": steps}
    config = make_config({**sizes, "compute.num_threads": threads, "compute.compiled": compiled})
    env = make_env(config)
    torch.manual_seed(config.seed)
    policy = make_policy(config, make_run_networks(config, env))
    collection = Collection(config, env, partial(make_env, config), policy)

    def close() -> None:
        collection.shutdown()
        env.close()

    return Contender(Key("training_policy", num_envs, threads), lambda: collection.collect().numel(), close)


def _riding_env(num_envs: int, threads: int, compiled: bool, compact_storage: bool = False) -> TransformedEnv:
    return make_riding_env(
        num_envs=num_envs, num_threads=threads, seed=0, compiled=compiled, compact_storage=compact_storage
    )


def _collected(
    name: str, env: TransformedEnv, policy: Callable[[TensorDictBase], TensorDictBase], threads: int, steps: int
) -> Contender:
    size = env.batch_size.numel()
    collector = Collector(
        env,
        policy,
        frames_per_batch=size * steps,
        total_frames=-1,
        exploration_type=ExplorationType.DETERMINISTIC,
        policy_device="cpu",  # as in training, like the next four; by default a collector checks at every step
        env_device="cpu",
        storing_device="cpu",
        track_traj_ids=False,
        return_same_td=True,
        trust_policy=True,  # a plain function may be a policy
        auto_register_policy_transforms=False,
    )
    batches = iter(collector)
    return Contender(Key(name, size, threads), lambda: next(batches).numel(), collector.shutdown)

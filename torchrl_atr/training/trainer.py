"""The recipe: env -> collector -> learner -> log -> checkpoint, until frames or minutes run out."""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from torchrl_atr._files import atomic
from torchrl_atr.envs import make_riding_env
from torchrl_atr.envs.task.rewards import MAX_TRACKING
from torchrl_atr.envs.task.state import CONTROL_DT
from torchrl_atr.envs.transforms import CommandGrid
from torchrl_atr.modules import NetworkKeys, RidingNetworks, correlate, get_estimator, leg_synergies, make_networks
from torchrl_atr.training.checkpoint import NAME, load_checkpoint, save_checkpoint
from torchrl_atr.training.collection import Collection
from torchrl_atr.training.config import ConfigError, TrainConfig
from torchrl_atr.training.learner import Learner
from torchrl_atr.training.metrics import batch_metrics
from torchrl_atr.training.progress import Progress
from torchrl_atr.training.provenance import provenance
from torchrl_atr.training.restoring import load_networks, run_config

DEPLOYED: dict[str, Any] = {"moving_start": 0.0, "pushes": False, "runaway_margin": None, "max_steps": 2**31 - 1}
"""Env arguments without what belongs to training only: a ride from rest that nothing but a fall ends."""


def make_env(config: TrainConfig, **overrides: Any) -> TransformedEnv:
    """The env that a configuration describes.

    Args:
        config: of a run.
        **overrides: arguments of :func:`torchrl_atr.envs.make_riding_env` to replace.
    """
    arguments: dict[str, Any] = {
        "robot": config.robot,
        "transporter": config.transporter,
        "num_envs": config.num_envs,
        "profile": config.profile,
        "num_threads": config.num_threads or None,
        "seed": config.seed,
        "moving_start": config.moving_start,
        "history_length": config.history_length,
        "max_steps": round(config.episode_seconds / CONTROL_DT),
        "window": round(config.command_seconds / CONTROL_DT),
        "thresholds": (config.tracking_threshold,) * 2,
        "score_from": round(config.score_from_seconds / CONTROL_DT),
        "runaway_margin": (config.runaway_speed, config.runaway_yaw_rate),
        "grid": CommandGrid(
            initial=(config.initial_speed, config.initial_yaw_rate), count_own_twice=config.count_own_twice
        ),
    }
    return make_riding_env(**{**arguments, **overrides})


def import_modules(names: Sequence[str]) -> None:
    """Imports user modules, so that they register their estimators; the working directory counts, as for ``python -m``.

    Raises:
        ConfigError: if one cannot be imported.
    """
    for name in names:
        if name.endswith(".py") or not all(name.split(".")):
            raise ConfigError(f"cannot import {name!r}; give a module's name, such as my_module for my_module.py")
    if names and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    for name in names:
        try:
            importlib.import_module(name)
        except (ImportError, SyntaxError) as error:
            raise ConfigError(
                f"cannot import {name!r} ({error}); run where it can be found, and imports alone"
            ) from error


def make_run_networks(config: TrainConfig, env: TransformedEnv) -> RidingNetworks:
    """The networks that a configuration describes, sized by the env's specs.

    Raises:
        UnknownNameError: for an unregistered estimator.
    """
    basis = leg_synergies()
    alike, joints = len(basis) // 4, len(basis)
    size = env.observation_spec["observation"].shape[-1]  # the command ends o_t
    return make_networks(
        env.observation_spec,
        env.action_spec,
        estimator=config.estimator,
        critic_cells=config.critic_cells,
        init_std=[config.init_std] * alike + [config.relative_std] * (joints - alike),
        min_std=config.min_std,
        noise_basis=basis,
        products=[(size - 2, size - 1)] if config.steering_cue else [],
        keys=NetworkKeys() if config.dead_reckoning else NetworkKeys(odometry=None),
    )


def load_run(run: Path, **env_overrides: Any) -> tuple[TrainConfig, TransformedEnv, RidingNetworks, dict[str, Any]]:
    """Config, env, trained networks and the whole checkpoint of a run folder.

    Args:
        run: the folder.
        **env_overrides: see :func:`make_env`.

    Raises:
        CheckpointError: if there is no readable checkpoint, or it does not fit this code.
    """
    state = load_checkpoint(run)
    config = run_config(state, run, device="cpu")  # wherever it was trained
    import_modules(config.imports)
    env = make_env(config, **env_overrides)
    networks = make_run_networks(config, env)
    load_networks(networks, state["learner"]["networks"], run)
    return config, env, networks, state


class Trainer:
    """One run in one folder.

    Args:
        config: the recipe.
        run: folder for config, checkpoint, logs; made if missing.
        state: a checkpoint to go on from.
    """

    def __init__(self, config: TrainConfig, run: Path, state: dict[str, Any] | None = None) -> None:
        self.config, self.run = config, run
        import_modules(config.imports)
        get_estimator(config.estimator)  # an unknown name is refused before anything is written
        run.mkdir(parents=True, exist_ok=True)
        torch.manual_seed(config.seed)
        self.env = make_env(config)
        self.curriculum = self.env.transform[0]
        scale = CONTROL_DT if self.env.base_env.readings.rewards_times_dt else 1.0
        self._tracking_max = {name: scale * value for name, value in MAX_TRACKING.items()}
        networks = make_run_networks(config, self.env)
        with torch.no_grad():
            networks.update_normalizers(self.env.rollout(config.rollout_steps))
        self.learner = Learner(networks.to(config.device), config)
        self.frames, self.iteration, self.seconds = 0, 0, 0.0
        if state is not None:
            self._restore(state)
        self.progress = Progress(run, config, resume_from=self.frames if state is not None else None)

    def train(self, on_iteration: Callable[[dict[str, float]], None] | None = None) -> None:
        """Trains until ``total_frames`` or ``max_minutes``, saving a checkpoint first, now and then, and last.

        Args:
            on_iteration: called with each iteration's metrics.
        """
        config = self.config
        write_json(self.run / "config.json", config.to_dict())
        self.save()
        policy = self.learner.networks.rollout_policy(config.act_source, config.student_fraction)
        self.collection = Collection(
            config, self.env, partial(make_env, config), correlate(policy, config.noise_correlation)
        )
        saved = time.monotonic()
        started = time.monotonic() - self.seconds
        try:
            with self.progress:
                batches = iter(self.collection)
                while not self.finished:
                    self.learner.anneal(self.progress_made)
                    metrics = self._iterate(next(batches), started)
                    self.progress.update(metrics)
                    if on_iteration is not None:
                        on_iteration(metrics)
                    if time.monotonic() - saved > config.checkpoint_seconds:
                        self.save()
                        saved = time.monotonic()
        except KeyboardInterrupt:
            sys.stdout.write(f"stopped; go on with: torchrl-atr train --resume {self.run}\n")
        finally:
            self.collection.shutdown()
            self.save()

    @property
    def progress_made(self) -> float:
        """Share of the frames or of the minutes that is used up, whichever is larger; 1 or more ends the run."""
        by_frames, minutes = self.frames / self.config.total_frames, self.config.max_minutes
        return max(by_frames, self.seconds / 60 / minutes) if minutes > 0 else by_frames

    @property
    def finished(self) -> bool:
        """Whether frames or minutes have run out."""
        return self.progress_made >= 1

    def _iterate(self, batch: TensorDictBase, started: float) -> dict[str, float]:
        collected = time.monotonic()
        metrics = batch_metrics(batch, self._tracking_max)
        metrics.update(self.learner.update(batch))
        self.collection.publish()
        self.collection.exchange()
        now = time.monotonic()
        elapsed = now - started
        metrics["collect_seconds"] = collected - started - self.seconds
        metrics["learn_seconds"] = now - collected
        self.frames += self.config.frames_per_batch
        self.iteration += 1
        metrics["frames_per_second"] = self.config.frames_per_batch / (elapsed - self.seconds)
        self.seconds = elapsed
        metrics["frames"], metrics["iteration"], metrics["minutes"] = self.frames, self.iteration, elapsed / 60
        metrics["command_area"] = self.curriculum.command_area[0]
        metrics["frontier_speed"], metrics["frontier_yaw_rate"] = self.curriculum.frontier
        metrics["std"] = float(self.learner.networks.backbone.std().detach().mean())
        metrics["diverged"] = self.collection.num_diverged
        return metrics

    def save(self) -> None:
        """Writes the checkpoint (config, learner, curriculum, counters) and where it comes from."""
        origin = provenance(self.config, self.frames, self.seconds)
        write_json(self.run / "run.json", origin)
        save_checkpoint(
            self.run / NAME,
            {
                "config": self.config.to_dict(),
                "learner": self.learner.state_dict(),
                "curriculum": {"weights": self.curriculum.weights, **self.curriculum.get_extra_state()},
                "frames": self.frames,
                "iteration": self.iteration,
                "seconds": self.seconds,
                "rng": torch.get_rng_state(),
                "env_rng": self.env.base_env.rng.get_state(),
                "provenance": origin,
            },
        )

    def _restore(self, state: dict[str, Any]) -> None:
        load_networks(self.learner.networks, state["learner"]["networks"], self.run)
        self.learner.load_state_dict(state["learner"])
        self.curriculum.load_weights(state["curriculum"]["weights"])
        self.curriculum.set_extra_state({k: v for k, v in state["curriculum"].items() if k != "weights"})
        self.frames, self.iteration = state["frames"], state["iteration"]
        self.seconds = state["seconds"]
        torch.set_rng_state(state["rng"])
        self.env.base_env.rng.set_state(state["env_rng"])


def write_json(path: Path, value: Any) -> None:
    """Writes ``value``, whole or not at all."""
    with atomic(path) as file:
        file.write_text(json.dumps(value, indent=2) + "\n")

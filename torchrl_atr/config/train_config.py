"""Configuration of a run: nested, typed groups of settings, from Python, a file or the command line."""

from __future__ import annotations

import dataclasses
import inspect
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchrl_atr._registry import import_modules
from torchrl_atr._settings import ConfigError, Settings, setting, settings
from torchrl_atr.config.conflicts import conflicts
from torchrl_atr.config.env_settings import CurriculumConfig, EnvConfig, TaskConfig
from torchrl_atr.config.estimator_settings import EstimatorConfig
from torchrl_atr.config.files import read_values
from torchrl_atr.config.learning_settings import (
    ComputeConfig,
    ExplorationConfig,
    LoggingConfig,
    PPOConfig,
    ROAConfig,
)
from torchrl_atr.config.nested import build, from_text, merged
from torchrl_atr.envs.models.files import COPIES
from torchrl_atr.envs.models.spec_file import is_spec_file
from torchrl_atr.envs.tasks import TASKS, Task, make_task
from torchrl_atr.envs.tasks.overrides import override
from torchrl_atr.envs.transforms import CommandGrid


@dataclass(frozen=True)
class TrainConfig(Settings):
    """All settings of a run; ``torchrl-atr list settings`` describes each.

    The defaults are riding's. :func:`make_config` also takes the settings of the task and the preset that differ from
    them, as the command line does; this class does not.

    Raises:
        ConfigError: for a value that is unknown, out of range, or does not go with another; names both and the remedy.
        UnknownNameError: for an unknown task, robot or transporter.

    Example:
        >>> TrainConfig(ppo=PPOConfig(gamma=0.9)).ppo.gamma
        0.9
    """

    preset: str = setting("default", alias="preset")
    """A registered preset, whose settings replace the defaults: `list presets`."""
    seed: int = setting(0, within=(0, 2**31 - 1), alias="seed")
    """Seed of everything."""
    total_frames: int = setting(15_000_000, within=(1, 1e15), alias="total-frames", paper=28_000_000)
    """Robot steps after which training ends, those of earlier sessions of the run included."""
    max_minutes: float = setting(0.0, within=(0, 1e9), unit="minutes", alias="max-minutes")
    """Wall-clock time after which training ends, whichever comes first; 0 for no limit."""
    imports: tuple[str, ...] = setting(())
    """Modules imported first, so that they can register tasks, estimators, robots and transporters."""
    env: EnvConfig = field(default_factory=EnvConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    exploration: ExplorationConfig = field(default_factory=ExplorationConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    roa: ROAConfig = field(default_factory=ROAConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    compute: ComputeConfig = field(default_factory=ComputeConfig)
    logging: LoggingConfig = field(default_factory=LoggingConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        import_modules(self.imports)  # first: they register the names that are checked
        for problem in conflicts(self, self.make_task()):
            raise ConfigError(problem)
        files: dict[str, Any] = {
            name: str(Path(value).resolve()) for name in COPIES if is_spec_file(value := getattr(self.task, name))
        }
        if files:  # workers must find them from any directory
            object.__setattr__(self, "task", dataclasses.replace(self.task, **files))

    @property
    def compiles_networks(self) -> bool:
        """True if policy and losses are compiled too: only on a CPU, where it was measured."""
        return self.compute.compiled and self.compute.device == "cpu"

    @property
    def captures_graphs(self) -> bool:
        """True if optimiser steps are captured as CUDA graphs: the effect of ``compiled`` for a learner on a GPU."""
        return self.compute.compiled and self.compute.device != "cpu"

    def make_task(self, **overrides: Any) -> Task:
        """Return the task, with some arguments of its function replaced.

        Raises:
            ConfigError: for a setting that the task does not have.
            UnknownNameError: for an unknown task, robot or transporter.
        """
        own, function = self.task, TASKS.get(self.task.name)
        known = inspect.signature(function).parameters
        given = {each.name: getattr(own, each.name) for each in dataclasses.fields(own)}
        given |= {"profile": own.interpretation, "steering_weight_peak_at": self.exploration.anneal_until}
        given["gains"] = (own.kp, own.kd) if own.kp or own.kd else None
        for name in given.keys() - known.keys() - _HELD:
            if given[name] not in self._unset(name):
                raise ConfigError(
                    f"task.{name}={given[name]!r}: the task {own.name!r} has no {name}; leave it out, or take "
                    "--task riding"
                )
        passed = {name: value for name, value in given.items() if name in known and name not in ("name", "rewards")}
        return override(make_task(own.name, **{**passed, **overrides}), own.rewards, own.randomization)

    def _unset(self, name: str) -> list[Any]:
        """Return the values of a task's setting that ask for nothing: default, the preset's, the task's, and off."""
        from torchrl_atr.config.presets import PRESETS, TASK_SETTINGS

        default, path = getattr(TaskConfig(), name, None), f"task.{name}"
        given = [
            known.get(path, default) for known in (PRESETS.get(self.preset), TASK_SETTINGS.get(self.task.name, {}))
        ]
        return [default, *given, *([each.value_in("paper")] if (each := settings(TrainConfig).get(path)) else [])]

    @property
    def title(self) -> str:
        """Robot and task in a few words."""
        task = self.task
        return f"{task.robot} on {task.transporter}" if task.name == "riding" else f"{task.robot} {task.name}"

    @property
    def grid(self) -> CommandGrid | None:
        """Command grid of the curriculum; None for a task without one."""
        return self.curriculum.bound(self.make_task().command.grid)

    @property
    def frames_per_batch(self) -> int:
        """Robot steps in one iteration."""
        return self.env.num_envs * self.ppo.rollout_steps

    def to_dict(self) -> dict[str, Any]:
        """Return nested plain JSON values."""
        return json.loads(json.dumps(dataclasses.asdict(self)))


def make_config(*sources: Mapping[str, Any]) -> TrainConfig:
    """Make a configuration from several sources; later ones win: defaults, the preset's, the task's, then these.

    Args:
        *sources: nested mappings, as files hold them, or dotted names; such as a file's and the command line's.

    Raises:
        ConfigError: for an unknown setting, a value of the wrong kind or out of range.
        UnknownNameError: for an unknown preset, task, robot or transporter.

    Example:
        >>> config = make_config({"env": {"num_envs": 8}, "preset": "paper"}, {"ppo.gamma": 0.9})
        >>> config.env.num_envs, config.ppo.gamma, config.ppo.symmetric
        (8, 0.9, False)
    """
    from torchrl_atr.config.presets import PRESETS, TASK_SETTINGS

    values = merged(*sources)
    imports = values.get("imports", ())
    if isinstance(imports, list | tuple) and all(isinstance(name, str) for name in imports):
        import_modules(imports)  # first: they may register tasks and presets
    task = values.get("task", {})
    name = task.get("name", "riding") if isinstance(task, Mapping) else "riding"
    own = TASK_SETTINGS.get(name, {}) if isinstance(name, str) else {}
    return build(TrainConfig, merged(PRESETS.get(values.get("preset", "default")), own, values))


def parse_settings(texts: Mapping[str, str]) -> dict[str, Any]:
    """Return settings that were given as texts, by dotted name, for :func:`make_config`.

    Example:
        >>> parse_settings({"ppo.critic_cells": "256,128", "compute.compiled": "true"})
        {'ppo.critic_cells': [256.0, 128.0], 'compute.compiled': True}
    """
    return {path: from_text(TrainConfig, path, text) for path, text in texts.items()}


def read_config(path: str | Path) -> dict[str, Any]:
    """Return the settings of a ``.toml`` or ``.json`` file, nested.

    A robot's file is looked up in its folder, as in a run's ``config.toml``, else in the working directory.

    Raises:
        ConfigError: if it is missing, of another kind, or malformed.
    """
    path = Path(path)
    values = read_values(path)
    task: Any = values.get("task")
    for name in COPIES if isinstance(task, dict) else ():
        if is_spec_file(task.get(name)) and (file := path.parent / task[name]).is_file():
            task[name] = str(file)
    return values


_HELD = {
    "name",
    "rewards",
    "randomization",
    "kp",
    "kd",
    "interpretation",
    "profile",
    "pushes",
    "steering_weight_peak_at",
}
"""Task settings that reach a task otherwise than as an argument of that name, or have parts of their own."""

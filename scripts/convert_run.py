"""Converter of a run's checkpoints to the current version: ``python scripts/convert_run.py RUN [OUTPUT]``.

Without OUTPUT the run folder itself is converted; with it, a copy. Files of the current version stay as they are.

To change the contents of a checkpoint: raise ``VERSION`` in ``torchrl_atr/runs/checkpoint.py`` by one and append a
function to :data:`CONVERSIONS` that converts a state of the previous version to the new one, in place.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch

sys.path.insert(0, str(Path(__file__).parents[1]))  # this clone's package, whatever is installed

from torchrl_atr._errors import UserError
from torchrl_atr._files import atomic
from torchrl_atr.config import TrainConfig
from torchrl_atr.config.files import to_toml
from torchrl_atr.config.nested import merged
from torchrl_atr.runs.checkpoint import BEST, NAME, PREVIOUS, VERSION, CheckpointError, read_checkpoint
from torchrl_atr.runs.files import CONFIG
from torchrl_atr.runs.restoring import SINCE

State = dict[str, Any]


def separate_exploration(state: State) -> None:
    """Convert 1 to 2: exploration is a separate module, optional inputs have lists of normalisers.

    Parameters keep their order, so the optimisers' moments stay as they are.
    """
    _rename_weights(
        state,
        {
            "backbone.std.raw": "exploration.raw",
            "backbone.noise_basis": "exploration.basis",
            "backbone.head": "backbone.output_map",
            "extrinsic_estimator.side_norm.": "extrinsic_estimator.side_norms.0.",
            "critic.outlook_norm.": "critic.input_norms.0.",
        },
    )
    state["config"].setdefault("tracking_forecast", True)  # a profile might say otherwise


def describe_the_task(state: State) -> None:
    """Convert 2 to 3: the task has a name, command grids have options, envs save other entries.

    Unfinished episodes are dropped: a resumed run starts new ones, as a run with workers does.
    """
    settings = state["config"]
    settings.setdefault("task", "riding")
    for old, new in {"steering_emphasis": "steering_weight_peak", "final_emphasis": "steering_weight_end"}.items():
        if old in settings:
            settings[new] = settings.pop(old)
    options = {"forward_only": False, "still": 0.0, "turning": 0.0, "straight": 0.0}
    state["curriculum"]["grid"] = {**options, **state["curriculum"]["grid"]}
    for member in (state, *state.get("members", [])):
        member["collection"] = {}


NESTED: dict[str, str] = {
    "task": "task.name",
    "robot": "task.robot",
    "transporter": "task.transporter",
    "estimator": "estimator.name",
    "imports": "imports",
    "num_envs": "env.num_envs",
    "rollout_steps": "ppo.rollout_steps",
    "total_frames": "total_frames",
    "max_minutes": "max_minutes",
    "seed": "seed",
    "device": "compute.device",
    "num_threads": "compute.num_threads",
    "torch_threads": "compute.torch_threads",
    "compiled": "compute.compiled",
    "collector": "compute.collector",
    "workers": "compute.workers",
    "sensors": "task.sensors",
    "gamma": "ppo.gamma",
    "gae_lambda": "ppo.gae_lambda",
    "epochs": "ppo.epochs",
    "minibatches": "ppo.minibatches",
    "learning_rate": "ppo.learning_rate",
    "max_learning_rate": "ppo.max_learning_rate",
    "target_kl": "ppo.target_kl",
    "final_kl": "ppo.final_kl",
    "critic_learning_rate": "ppo.critic_learning_rate",
    "estimator_learning_rate": "estimator.learning_rate",
    "clip_epsilon": "ppo.clip_epsilon",
    "entropy_coeff": "ppo.entropy_coeff",
    "max_grad_norm": "ppo.max_grad_norm",
    "average_over": "ppo.ema_horizon",
    "init_std": "exploration.init_std",
    "relative_std": "exploration.relative_std",
    "min_std": "exploration.min_std",
    "noise_correlation": "exploration.noise_correlation",
    "final_std": "exploration.final_std",
    "anneal_from": "exploration.anneal_from",
    "anneal_until": "exploration.anneal_until",
    "smoothness_coeff": "ppo.smoothness_coeff",
    "roa_coeff": "roa.coeff",
    "roa_ramp": "roa.ramp",
    "adaptation_epochs": "estimator.epochs",
    "act_source": "roa.act_source",
    "dead_reckoning": "estimator.dead_reckoning",
    "steering_cue": "ppo.command_interaction",
    "symmetric": "ppo.symmetric",
    "normalize_targets": "estimator.normalize_targets",
    "privileged_critic": "ppo.privileged_critic",
    "tracking_forecast": "ppo.tracking_forecast",
    "history_length": "env.history_length",
    "critic_cells": "ppo.critic_cells",
    "moving_start": "task.moving_start",
    "displaced_start": "task.displaced_start",
    "retry": "env.failed_episode_replay",
    "episode_seconds": "env.episode_seconds",
    "command_seconds": "curriculum.command_seconds",
    "steering_weight_peak": "task.steering_weight_peak",
    "steering_weight_end": "task.steering_weight_end",
    "steering_emphasis": "task.steering_weight_peak",  # of version 2, in the settings of the run that it started from
    "final_emphasis": "task.steering_weight_end",
    "tracking_threshold": "curriculum.tracking_threshold",
    "score_from_seconds": "curriculum.score_from_seconds",
    "count_own_twice": "curriculum.count_own_twice",
    "initial_speed": "curriculum.initial_speed",
    "initial_yaw_rate": "curriculum.initial_yaw_rate",
    "max_speed": "curriculum.max_speed",
    "max_yaw_rate": "curriculum.max_yaw_rate",
    "checkpoint_seconds": "logging.checkpoint_seconds",
    "logger": "logging.logger",
}
"""Names in version 4 of the settings of version 3."""
_QUESTIONS = {
    "relative_mass": True,
    "odd_resistance": True,
    "coulomb_smoothing": 0.5,
    "steering_smoothing": 0.0,
    "sb_gains_per_degree": True,
    "scaled_springs": True,
    "gains_as_ratios": True,
    "relative_pose": True,
    "rewards_times_dt": True,
    "positive_rewards": False,
    "gravity_in_acceleration": False,
    "current_in_history": False,
    "contacting_polygon": False,
    "driven_smoothness": True,
    "tilt_limit": 1.0,
}
_PRINTED = ("relative_mass", "odd_resistance", "sb_gains_per_degree", "scaled_springs", "gains_as_ratios")
PROFILES: dict[str, tuple[str, dict[str, Any]]] = {
    "default": ("default", _QUESTIONS),
    "literal": (
        "literal",
        _QUESTIONS
        | dict.fromkeys((*_PRINTED, "relative_pose", "rewards_times_dt", "driven_smoothness"), False)
        | {"coulomb_smoothing": 0.0},
    ),
    "ancestor": (
        "legged_gym",
        _QUESTIONS
        | {"coulomb_smoothing": 0.0, "positive_rewards": True, "gravity_in_acceleration": True, "tilt_limit": 0.78},
    ),
}
"""Preset and answers in version 4 of the profiles of version 3."""


def nest_the_settings(state: State) -> None:
    """Convert 3 to 4: settings are grouped, and the profile becomes the answers to the open questions."""
    for owner in (state, state.get("start") or {}):
        if "config" in owner:
            owner["config"] = nested(owner["config"])


def nested(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of version 4 that are equivalent to those of version 3.

    Raises:
        CheckpointError: for a setting without a counterpart.
    """
    old = {name: value for name, value in flat.items() if name != "learners"}  # removed
    profile, fraction = old.pop("profile", "default"), old.pop("student_fraction", 0.5)
    margin = [old.pop(name, 2.0) for name in ("runaway_speed", "runaway_yaw_rate")]
    unknown = [name for name in old if name not in NESTED]
    if unknown or profile not in PROFILES or fraction != 0.5:
        wrong = f"{unknown[0]}={old[unknown[0]]!r}" if unknown else f"profile={profile!r}, student_fraction={fraction}"
        raise CheckpointError(f"its setting {wrong} has no counterpart; use the code that wrote it")
    preset, answers = PROFILES[profile]
    values = {NESTED[name]: value for name, value in old.items()}
    fixed: dict[str, Any] = {"env.staggered_starts": True, "exploration.leg_patterns": True, "exploration.anneal": True}
    velocity = "kalman_filter" if "sensors" in flat else "integral"
    fixed |= {"task.sensors": "ideal", "task.displaced_start": 0.0, "task.velocity_filter": velocity}
    more = {"preset": preset, "env.overspeed_margin": margin, "ppo.kl_stop": 5.0, "task.interpretation": answers}
    return merged(TrainConfig().to_dict(), SINCE, {**fixed, **more}, values)


CONVERSIONS: tuple[Callable[[State], None], ...] = (separate_exploration, describe_the_task, nest_the_settings)
"""Conversions from version 1 to 2, from 2 to 3, and so on."""


def convert(state: State) -> None:
    """Convert a checkpoint's state to :data:`~torchrl_atr.runs.checkpoint.VERSION`, in place.

    Raises:
        CheckpointError: if its version is unknown, or an entry of that version is missing.
    """
    version = state["version"]
    if not isinstance(version, int) or not 1 <= version <= VERSION:
        raise CheckpointError(f"version {version!r} is unknown here; versions 1 to {VERSION} can be converted")
    for conversion in CONVERSIONS[version - 1 :]:
        try:
            conversion(state)
        except KeyError as error:
            raise CheckpointError(f"it holds no {error}, as version {state['version']} does") from error
        state["version"] += 1


def convert_run(run: Path, output: Path | None = None) -> list[str]:
    """Convert the checkpoints and the settings of a run folder.

    Args:
        run: the folder.
        output: folder for a converted copy, which must not exist; None to convert ``run`` itself.

    Returns:
        The names of the converted files.

    Raises:
        CheckpointError: if there is no checkpoint, one cannot be read or converted, or ``output`` exists.
        OSError: if a file cannot be written.
    """
    files = [run / name for name in (NAME, PREVIOUS, BEST) if (run / name).is_file()]
    if not files:
        raise CheckpointError(f"there is no checkpoint in {run}; give a run folder that `torchrl-atr train` wrote")
    states = {path.name: read_checkpoint(path) for path in files}
    old = {name: state for name, state in states.items() if state["version"] != VERSION}
    for name, state in old.items():  # all of them, before anything is written
        try:
            convert(state)
        except CheckpointError as error:
            raise CheckpointError(f"{run / name} cannot be converted: {error}") from error
    if output is not None:
        if output.exists():
            raise CheckpointError(f"{output} exists; give a folder that does not")
        shutil.copytree(run, output)
        run = output
    for name, state in old.items():
        with atomic(run / name) as temporary:
            torch.save(state, temporary)
            read_checkpoint(temporary)
    if NAME in old:
        with atomic(run / CONFIG) as temporary:
            temporary.write_text(to_toml(TrainConfig, old[NAME]["config"]), encoding="utf-8")
        (run / "config.json").unlink(missing_ok=True)  # of version 3 and before
    return list(old)


def _rename_weights(state: State, names: Mapping[str, str]) -> None:
    """Rename the networks' weights, and their running mean, by the prefixes of their names."""
    learner = state["learner"]
    for part in ("networks", "deployed"):
        if part in learner or part == "networks":
            learner[part] = {_renamed(name, names): value for name, value in learner[part].items()}


def _renamed(name: str, names: Mapping[str, str]) -> str:
    for old, new in names.items():
        if name.startswith(old):
            return new + name.removeprefix(old)
    return name


def main(arguments: list[str] | None = None) -> int:
    """Convert the run that the command line names; return 2 if that fails."""
    parser = argparse.ArgumentParser(description="Convert a run's checkpoints to the version that this code reads.")
    parser.add_argument("run", type=Path, metavar="RUN", help="folder that `torchrl-atr train` wrote")
    parser.add_argument("output", type=Path, metavar="OUTPUT", nargs="?", help="new folder for a converted copy")
    given = parser.parse_args(arguments)
    try:
        converted = convert_run(given.run, given.output)
    except (UserError, OSError) as error:
        print(f"convert_run: {error}", file=sys.stderr)
        return 2
    where = given.run if given.output is None else given.output
    print(f"{where}: {', '.join(converted) or 'nothing'} converted; all is of version {VERSION}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Figure 7: ablations of A1 on the single board, trained for equal frames with several seeds, and measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from torchrl_atr._errors import InputError
from torchrl_atr._files import say
from torchrl_atr._interrupt import Stopped
from torchrl_atr._registry import unknown
from torchrl_atr._text import markdown_table
from torchrl_atr.evaluation import TrackingResult, command_area
from torchrl_atr.evaluation.intervals import welch_difference
from torchrl_atr.reproduction.policies import RiderPolicy, load_rider
from torchrl_atr.reproduction.report import Claim, Job, judge, with_interval, write_report
from torchrl_atr.reproduction.tracking import EPSILONS, THRESHOLD, Grid, measure, tracking_figures, within
from torchrl_atr.runs.checkpoint import NAME
from torchrl_atr.training import TrainConfig, Trainer, checkpoint_config, load_checkpoint, make_config

FULL = "full"
VARIANTS: dict[str, dict[str, Any]] = {
    FULL: {},
    "no curriculum": {"curriculum.initial_speed": 0.0, "curriculum.initial_yaw_rate": 0.0},
    "no intrinsic": {"roa.actor_reads": ("extrinsic",)},
    "no extrinsic": {
        "roa.actor_reads": ("latent",),
        "ppo.tracking_errors": False,
        "estimator.dead_reckoning": False,
        "env.reposition_feet": 0.0,
    },
    "no dead reckoning": {"estimator.dead_reckoning": False},
    "no symmetry": {"ppo.symmetric": False},
    "no ROA": {"roa.coeff": 0.0},
}
"""Settings of each ablation; the first four are the paper's. Without extrinsic states, the inputs that are made of
their estimates are left out, too, and there are no scripted steps, which need to know where feet are."""
_CLAIMS = {
    "no curriculum": "Without the command curriculum, training fails to follow commands",
    "no intrinsic": "Without intrinsic information, less of the command space is covered",
    "no extrinsic": "Without extrinsic information, less of the command space is covered",
}


class Sizes(NamedTuple):
    """Budget of each training."""

    frames: int | None = None
    seeds: int = 3
    settings: Mapping[str, Any] = MappingProxyType({})


QUICK = Sizes(4096, 2, {"env.num_envs": 32, "ppo.actor_cells": [64, 32], "ppo.critic_cells": [32]})
"""Sizes that show that everything works."""


def figure7(
    job: Job,
    folder: Path,
    variants: Sequence[str] | None = None,
    frames: int | None = None,
    seeds: int | None = None,
    settings: Mapping[str, Any] | None = None,
    grid: Grid | None = None,
) -> Path:
    """Train and measure the ablations; write figures, ``figure7.json`` and the page.

    What a run folder among the parts holds is continued; a finished training is not made again.

    Args:
        job: seed of the first training, and finished parts; its policies are not used.
        folder: to write to.
        variants: names of :data:`VARIANTS`; by default all.
        frames: robot steps of each training; by default the recipe's ``total_frames``.
        seeds: trainings of each variant.
        settings: of all trainings, nested or by dotted name, such as a file of ``train --config`` holds.
        grid: commands and trials of the measurement; by default the job's.

    Raises:
        UnknownNameError: for an unknown variant. InputError: for wrong settings, those of another robot, transporter or
            seed, and variants that change nothing; before anything is trained.
        Stopped: when a signal stops a training, which is saved; the same command goes on with it.
    """
    from torchrl_atr.reproduction.figures import plot_areas, plot_error_maps  # imports matplotlib

    names = chosen_variants(variants)
    sizes = QUICK if job.quick else Sizes()
    count = seeds or sizes.seeds
    _check_settings(settings or {})
    configs = {
        (name, seed): _config(name, seed, sizes, frames, settings or {}, job.imports)
        for name in dict.fromkeys((FULL, *names))
        for seed in range(job.seed, job.seed + count)
    }
    same = [name for name in names if name != FULL and configs[name, job.seed] == configs[FULL, job.seed]]
    names = [name for name in names if name not in same]
    if not names:
        raise InputError(f"{', '.join(same)}: these settings are those of {FULL!r} already; choose other variants")
    configs = {(name, seed): config for (name, seed), config in configs.items() if name in names}
    results: dict[str, list[TrackingResult]] = {name: [] for name in names}
    for number, ((name, seed), config) in enumerate(configs.items(), 1):
        say(f"{name}, seed {seed}: training {number} of {len(configs)}")
        policy = _trained(job, name, config)
        results[name].append(measure(job, policy, grid))
    plot_error_maps(results, ["combined"], folder / "heatmaps.png")
    plot_areas(results, folder / "command_area.png")
    figures = {name: _figures(each) for name, each in results.items()}
    one = next(iter(configs.values()))
    text = (
        f"A1 on the single board: {one.total_frames:,} robot steps for each of {count} seeds of each variant, measured "
        f"as Figure 4. Area: share of the trials within √(e_v² + e_ω²) ≤ {THRESHOLD:g}, root mean square over the "
        "trial from rest. Brackets of the first table: the lowest and the highest seed; of the claims: Welch's t "
        "interval over seeds. Heat maps are means over seeds, bands reach from the lowest seed to the highest. The "
        "paper trains for 75,000 episodes, and prints no number."
    )
    if same:
        text += f" Left out, as the settings of all trainings are theirs already: {', '.join(same)}."
    sections = [text, _table(figures), "![command areas](command_area.png)", "![combined errors](heatmaps.png)"]
    return write_report(
        job,
        folder,
        "figure7",
        "Figure 7: ablations",
        sections,
        _claims(results),
        variants={name: {"settings": _plain(VARIANTS[name]), **each} for name, each in figures.items()},
        command_area={
            "epsilon": EPSILONS,
            **{name: [command_area(r, EPSILONS)["rms"] for r in each] for name, each in results.items()},
        },
        frames=one.total_frames,
        seeds=list(range(job.seed, job.seed + count)),
    )


def chosen_variants(variants: Sequence[str] | None) -> list[str]:
    """Return the names of variants in the order of :data:`VARIANTS`; of all without a choice.

    Raises:
        UnknownNameError: for an unknown one.
    """
    for name in variants or ():
        if name not in VARIANTS:
            raise unknown("variant", name, VARIANTS)
    return [name for name in VARIANTS if variants is None or name in variants]


def _check_settings(settings: Mapping[str, Any]) -> None:
    config = make_config(settings)
    given = {"task.robot": config.task.robot, "task.transporter": config.task.transporter, "seed": config.seed}
    for (name, value), own in zip(given.items(), ("a1", "single_board", 0)):
        if value != own:
            raise InputError(
                f"{name}={value!r}: Figure 7 is of A1 on the single board, and --seed gives its seeds; leave it out"
            )


def _config(
    name: str, seed: int, sizes: Sizes, frames: int | None, settings: Mapping[str, Any], imports: Sequence[str]
) -> TrainConfig:
    asked = {"task.robot": "a1", "task.transporter": "single_board", "seed": seed, "logging.logger": "csv"}
    total = frames or sizes.frames
    asked |= {} if total is None else {"total_frames": total}
    asked |= {"imports": list(imports)} if imports else {}
    return make_config(sizes.settings, settings, asked, VARIANTS[name])


def _trained(job: Job, name: str, config: TrainConfig) -> RiderPolicy:
    """Return the policy of a training, which is begun, continued, or loaded if it has ended."""
    asked = {"settings": config.to_dict()}
    part = job.parts.place(f"train-{name.replace(' ', '_')}-{config.seed}", asked)
    run = part / "run"
    if not job.parts.holds(part):
        if (run / NAME).is_file():
            state = load_checkpoint(run)
            trainer = Trainer(checkpoint_config(state, run, job.imports, {}), run, state)
        else:
            trainer = Trainer(config, run)
        if not trainer.finished and (signal := trainer.train()) is not None:
            raise Stopped(signal)
        job.parts.finish(part, asked, trainer.seconds)
    return load_rider(run, job.imports)


def _figures(results: Sequence[TrackingResult]) -> dict[str, Any]:
    """Return the figures of each seed, and of their mean with the lowest and the highest seed."""
    seeds = [tracking_figures(result) for result in results]
    figures: dict[str, Any] = {"by_seed": seeds}
    for name in ("survival", "rms_speed_error", "rms_yaw_error", "area"):
        values = [each[name] for each in seeds]
        figures |= {name: float(np.mean(values)), f"{name}_of_seeds": [min(values), max(values)]}
    return figures


def _table(figures: Mapping[str, dict[str, Any]]) -> str:
    names = ("survival", "rms_speed_error", "rms_yaw_error", "area")
    rows = [
        [variant, *(with_interval(each[name], each[f"{name}_of_seeds"]) for name in names)]
        for variant, each in figures.items()
    ]
    return markdown_table(["variant", "up", "speed error, m/s", "yaw rate error, rad/s", "area"], rows)


def _claims(results: Mapping[str, Sequence[TrackingResult]]) -> list[Claim]:
    if FULL not in results:
        return []
    shares = {name: np.array([within(each).mean() for each in seeds]) for name, seeds in results.items()}
    claims = []
    for name in results:
        if name == FULL:
            continue
        test = f"command area, full minus {name}, means over seeds, above 0"
        text = _CLAIMS.get(name, f"(beyond the paper) {name} covers less of the command space")
        value, interval = welch_difference(shares[FULL], shares[name])
        claims.append(Claim(text, test, value, interval, judge(interval), f"From {len(shares[FULL])} seeds"))
    return claims


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}

"""Functions of the commands of ``torchrl-atr``."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchrl_atr._errors import UserError
from torchrl_atr._files import atomic, folder_for, say, whole
from torchrl_atr._registry import import_modules
from torchrl_atr.cli.bundles import export, verify
from torchrl_atr.cli.chosen import checkpoint_file, other_model
from torchrl_atr.cli.compare import compare
from torchrl_atr.cli.measured import Measured
from torchrl_atr.cli.navigate import navigate
from torchrl_atr.cli.play import play
from torchrl_atr.cli.plot import plot
from torchrl_atr.cli.printing import replay_head, replay_line, step_progress
from torchrl_atr.cli.protocols import PROTOCOLS, fill_options
from torchrl_atr.cli.reproduce import reproduce
from torchrl_atr.cli.summary import next_commands, run_figures
from torchrl_atr.cli.view import demo, view
from torchrl_atr.deploy.manifest import is_bundle, report_home
from torchrl_atr.listings import LISTINGS, settings_page

if TYPE_CHECKING:
    from torchrl_atr.cli.train_options import TrainArguments
    from torchrl_atr.training import TrainConfig, Trainer


def train(words: Sequence[str]) -> int:
    """Run ``torchrl-atr train``; if a signal stops it, return 128 plus the signal's number, as shells expect."""
    from torchrl_atr.cli.train_options import DEFAULT_RUN, parse_train
    from torchrl_atr.config.nested import merged
    from torchrl_atr.runs.checkpoint import NAME
    from torchrl_atr.training import ConfigError, Trainer, make_config, read_config

    arguments = parse_train(words)
    if arguments.resume is not None:
        return _resume(arguments)
    output = arguments.output or DEFAULT_RUN
    if (output / NAME).exists() and not arguments.overwrite:
        raise ConfigError(f"{output} holds a run; give another --output, --resume {output}, or --overwrite")
    given = merged(read_config(arguments.config) if arguments.config else {}, arguments.given)
    config, named = (make_config(given), set()) if arguments.start is None else _config_from(arguments.start, given)
    with folder_for(output):
        return _train(Trainer(config, output, begin_from=arguments.start, replaced=named))


def _config_from(run: Path, given: dict[str, Any]) -> tuple[TrainConfig, set[str]]:
    """Return another run's settings with the given ones in their place, and the names of the given task settings."""
    from torchrl_atr.config.presets import STUDENTS
    from torchrl_atr.runs.restoring import saved_settings
    from torchrl_atr.training import PRESETS, ConfigError, load_checkpoint, make_config

    settings = saved_settings(load_checkpoint(run), run, given.get("imports", ()))
    preset = given.get("preset", settings["preset"])
    second_phase = PRESETS.get(preset) if given.get("preset") in STUDENTS else {}
    if preset != settings["preset"] and not second_phase:  # its settings are all taken
        raise ConfigError(
            f"--preset {preset}: --from {run} keeps that run's, {settings['preset']}; leave it out, or give one of a "
            f"second phase: {', '.join(sorted(STUDENTS))}"
        )
    config = make_config(settings, second_phase, given, {"imports": settings["imports"]})
    return config, set(given.get("task", ()))


def _resume(arguments: TrainArguments) -> int:
    from torchrl_atr.cli.train_options import RESUMABLE, option
    from torchrl_atr.training import ConfigError, Trainer, checkpoint_config, load_checkpoint

    run, given = arguments.resume, arguments.given
    assert run is not None
    if is_bundle(run):
        raise ConfigError(f"--resume {run}: it is a policy bundle, not a run; begin a new run with --from {run}")
    places = [name for name in ("config", "output", "overwrite", "start") if getattr(arguments, name)]
    fixed = [name for name in (*given, *places) if name not in RESUMABLE]
    if fixed:
        names, allowed = (", ".join(map(option, group)) for group in (fixed, RESUMABLE))
        raise ConfigError(f"{names}: a resumed run keeps its settings, {allowed} excepted; leave it out")
    state = load_checkpoint(run)
    changed = {path: value for path, value in given.items() if path != "imports"}
    trainer = Trainer(checkpoint_config(state, run, given.get("imports", ()), changed), run, state)
    if trainer.finished:
        say(f"{run} has ended; to go on, give a larger --total-frames or --max-minutes")
        return 0
    return _train(trainer)


def _train(trainer: Trainer) -> int:
    """Train, and print where the run is, what it came to and what to do with it."""
    from torchrl_atr.runs.files import LOG

    signal = trainer.train()
    run, amount = shlex.quote(str(trainer.run)), f"{trainer.frames:,} robot steps in {trainer.seconds / 60:.1f} minutes"
    say(f"{'finished' if signal is None else 'stopped'} after {amount}; the run is in {run}")
    if signal is not None:
        say(f"go on with: torchrl-atr train --resume {run}")
    teacher = getattr(trainer.learner.networks, "is_teacher", False)
    following = next_commands(trainer.run, trainer.config.task.name, teacher)
    say("\n".join([*run_figures(trainer.run / LOG), *following]))
    return 0 if signal is None else 128 + signal


def evaluate(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr evaluate``."""
    from functools import partial

    from torchrl_atr.evaluation import run_figures
    from torchrl_atr.runs.files import LOG
    from torchrl_atr.training import DEPLOYMENT_OVERRIDES, load_run, make_env

    fill_options(arguments)
    arguments.output = output = _report_folder(arguments)
    other = other_model(arguments)
    imports = arguments.imports or ()
    config, env, networks, state = load_run(arguments.run, checkpoint_file(arguments), imports, num_envs=1, **other)
    env.close()
    if arguments.command_range != "apply":
        networks.command_range = None
    with folder_for(output):
        with step_progress("evaluating") as progress:
            chosen = {**DEPLOYMENT_OVERRIDES, **other, "randomization": arguments.randomization}
            if arguments.sensors is not None:
                chosen["sensors"] = arguments.sensors
            measured = PROTOCOLS[arguments.protocol].measure(
                arguments, config, networks, partial(make_env, config, **chosen), progress
            )
        metrics = measured.metrics
        metrics["evaluation"] = {
            "robot": env.base_env.scene.robot.name,
            "transporter": env.base_env.scene.support.name,
            "protocol": arguments.protocol,
            "seed": arguments.seed,
            "randomization": arguments.randomization,
            "sensors": arguments.sensors or config.task.sensors,
            "checkpoint": arguments.checkpoint,
            "act_source": arguments.act_source,
            "command_range": networks.command_range and dataclasses.asdict(networks.command_range),
        }
        metrics["run"] = state["provenance"]
        with whole(output) as folder:
            measured.write(folder)
            if (arguments.run / LOG).is_file():
                run_figures.plot_learning_curves(arguments.run / LOG, folder / "learning_curves.png")
            if state["curriculum"] is not None:
                weights = state["curriculum"]["weights"]
                run_figures.plot_curriculum(weights, env.curriculum.grid.bounds, folder / "curriculum.png")
        measured.finish()
    lines = [*measured.lines, f"report in {output}"]
    say("\n".join(lines if arguments.command_range != "record" else [*lines, _record_range(measured, arguments.run)]))


def _record_range(measured: Measured, run: Path) -> str:
    """Write the mastered range of commands into the run folder, or remove it if there is none; return a line on it."""
    from torchrl_atr.evaluation import TrackingResult, mastered_range
    from torchrl_atr.modules import COMMAND_RANGE_FILE

    assert isinstance(measured.result, TrackingResult)  # fill_options refuses other protocols
    limits = mastered_range(measured.result)
    if limits is None:
        (run / COMMAND_RANGE_FILE).unlink(missing_ok=True)
        return "no command is mastered: no range of commands to clip to"
    return f"wrote {limits.save(run)}: from now on commands are clipped to it"


def _report_folder(arguments: argparse.Namespace) -> Path:
    """Return the folder of the report; the run's own is for the robot and transporter that it was trained on."""
    from torchrl_atr.training import ConfigError

    home = report_home(arguments.run)
    if is_bundle(arguments.run) and arguments.command_range == "record":
        raise ConfigError(
            f"--command-range record: {arguments.run} is a policy bundle; record it in the run, and export that"
        )
    own = home if arguments.protocol == "tracking" else home / arguments.protocol
    output = arguments.output or own
    for name, value in other_model(arguments).items():
        if arguments.command_range == "record":
            raise ConfigError(
                f"--command-range record: it is the run's, not that of another {name}; leave out --{name}"
            )
        if output.resolve() in (home.resolve(), own.resolve()):
            raise ConfigError(
                f"--{name} {value}: the report in {output} is of the {name} that it was trained on; give "
                "another folder with --output"
            )
    return output


def _imports_of(dump: Path) -> Sequence[str]:
    """Return the modules that a dump's run imports; empty if the dump is not in a run's folder."""
    from torchrl_atr.runs.files import CONFIG
    from torchrl_atr.training import ConfigError, read_config

    try:
        return read_config(dump.resolve().parents[1] / CONFIG).get("imports", ())
    except (ConfigError, IndexError):
        return ()


def replay(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr replay``."""
    from torchrl_atr.evaluation import replay_failure

    import_modules(arguments.imports or _imports_of(arguments.dump))
    say(replay_head())
    with closing(replay_failure(arguments.dump, arguments.video)) as steps:  # finish the video in any case
        for step in steps:
            say(replay_line(step))
    if arguments.video is not None:
        say(f"wrote {arguments.video}")


def write_model(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr model``."""
    from torchrl_atr.envs import get_robot, get_transporter
    from torchrl_atr.envs.models import Transporter, scene_xml

    import_modules(arguments.imports or ())
    robot = get_robot(arguments.robot)
    xml = scene_xml(robot, Transporter(get_transporter(arguments.transporter, robot)))
    with atomic(arguments.output) as file:
        file.write_text(xml, encoding="utf-8")
    say(f"wrote {arguments.output}; keyframe 'stand' is the robot standing on its transporter")


def bench(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr bench``; its code is beside the package in a clone and is not installed."""
    root = Path(__file__).parents[2]
    if not (root / "benchmarks" / "bench.py").is_file():
        raise UserError("the benchmark is not part of the installed package; run it from a clone, after scripts/setup")
    sys.path.insert(0, str(root))
    from benchmarks.bench import FULL, QUICK, run

    command = "torchrl-atr bench --quick" if arguments.quick else "torchrl-atr bench"
    with folder_for(arguments.output) as folder:
        run(QUICK if arguments.quick else FULL, folder, command)
    say(f"{(folder / 'bench.md').read_text(encoding='utf-8')}report in {folder}")


def show_list(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr list``."""
    import_modules(arguments.imports or ())
    if arguments.markdown and arguments.what != "settings":
        raise UserError(f"--markdown is for settings, not for {arguments.what}; leave it out")
    say("\n".join(settings_page() if arguments.markdown else LISTINGS[arguments.what]()))


COMMANDS: dict[str, Any] = {
    "train": train,
    "evaluate": evaluate,
    "play": play,
    "demo": demo,
    "view": view,
    "export": export,
    "verify": verify,
    "navigate": navigate,
    "compare": compare,
    "plot": plot,
    "reproduce": reproduce,
    "replay": replay,
    "model": write_model,
    "bench": bench,
    "list": show_list,
}

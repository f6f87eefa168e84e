"""``torchrl-atr``: train | evaluate | play | model | bench | list."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchrl_atr import __version__
from torchrl_atr._errors import UserError
from torchrl_atr.listings import LISTINGS

_DEFAULT_RUN = Path("runs/latest")
_HEADLINES = (
    "survival",
    "settled_speed_error_straight",
    "settled_speed_error",
    "settled_yaw_error",
    "yaw_slope",
)
_SETTINGS = (
    "robot",
    "transporter",
    "profile",
    "estimator",
    "imports",
    "num_envs",
    "total_frames",
    "max_minutes",
    "seed",
    "device",
    "collector",
    "workers",
)
"""Settings that have an option of their own."""
_RESUMABLE = ("total_frames", "max_minutes")


def build_parser() -> argparse.ArgumentParser:
    """The command line, every command with its help."""
    parser = argparse.ArgumentParser(prog="torchrl-atr", description=__doc__)
    parser.add_argument("--version", action="version", version=f"torchrl-atr {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    _add_train(commands.add_parser("train", help="learn to ride; go on from a run with --resume"))
    _add_evaluate(commands.add_parser("evaluate", help="measure the deployed policy over a grid of commands"))
    _add_play(commands.add_parser("play", help="watch the deployed policy, or film it with --video"))
    _add_bench(commands.add_parser("bench", help="measure speed against limits and peers (from a clone)"))
    model = commands.add_parser("model", help="write a robot on its transporter as one MJCF file")
    model.add_argument("robot", help="a name, or a .toml file that describes one of your own")
    model.add_argument("transporter")
    model.add_argument("--output", type=Path, required=True, metavar="FILE", help="an .xml for python -m mujoco.viewer")
    listing = commands.add_parser("list", help="list what is registered")
    listing.add_argument("what", choices=sorted(LISTINGS))
    return parser


def _add_train(parser: argparse.ArgumentParser) -> None:
    # names match TrainConfig's fields; None means "as the config file or the default says"
    parser.add_argument("--robot", help="a name, or a .toml file that describes one of your own")
    parser.add_argument("--transporter")
    parser.add_argument("--profile", help="how the paper's open points are read")
    parser.add_argument("--estimator", help="a registered estimator")
    parser.add_argument("--import", dest="imports", action="append", metavar="MODULE", help="import it first")
    parser.add_argument("--num-envs", type=int)
    parser.add_argument("--total-frames", type=float, help="robot steps, absolute")
    parser.add_argument("--max-minutes", type=float, help="wall clock, earlier sessions of the run included")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--device")
    parser.add_argument("--collector", help="where robots are simulated: direct, process, ray or distributed")
    parser.add_argument("--workers", type=int, help="processes that share robots and CPUs, unless direct")
    parser.add_argument("--config", type=Path, metavar="FILE", help=".toml or .json with any setting")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--output", type=Path, metavar="RUN", help=f"the run folder; default: {_DEFAULT_RUN}")
    parser.add_argument("--overwrite", action="store_true", help="replace a run in that folder")
    parser.add_argument("--resume", type=Path, metavar="RUN", help="go on from this run's checkpoint")


def _add_evaluate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, help="where the report goes; default: the run folder")
    parser.add_argument("--transporter", help="measure on another one than it was trained on; needs --output")
    parser.add_argument("--randomization", choices=("train", "test", "off"), default="train")
    parser.add_argument("--max-speed", type=float, default=2.0, help="m/s")
    parser.add_argument("--max-yaw-rate", type=float, default=1.0, help="rad/s")
    parser.add_argument("--speed-step", type=float, default=1.0)
    parser.add_argument("--yaw-rate-step", type=float, default=0.25)
    parser.add_argument("--robots-per-command", type=int, default=8)


def _add_play(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path)
    parser.add_argument("--transporter", help="ride another one than it was trained on")
    parser.add_argument("--video", type=Path, help="write an .mp4 or .gif instead of opening a viewer")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)


def _add_bench(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="tiny sizes: shows that it works, measures nothing")
    parser.add_argument("--output", type=Path, default=Path("results/bench"), metavar="DIR")


def train(arguments: argparse.Namespace) -> int:
    """``torchrl-atr train``; a run that a signal stopped ends as shells expect, with 128 and the signal's number."""
    from torchrl_atr.training import ConfigError, Trainer, make_config, read_config
    from torchrl_atr.training.checkpoint import NAME

    if arguments.resume is not None:
        return _resume(arguments)
    output = arguments.output or _DEFAULT_RUN
    if (output / NAME).exists() and not arguments.overwrite:
        raise ConfigError(f"{output} holds a run; give another --output, --resume {output}, or --overwrite")
    values = read_config(arguments.config) if arguments.config else {}
    values |= {name: getattr(arguments, name) for name in _SETTINGS if getattr(arguments, name) is not None}
    return _exit_code(Trainer(make_config(values, arguments.overrides), output).train())


def _resume(arguments: argparse.Namespace) -> int:
    from torchrl_atr.training import ConfigError, Trainer, load_checkpoint, make_config

    fixed = [name for name in (*_SETTINGS, "config", "output") if getattr(arguments, name) is not None]
    fixed = [name for name in fixed if name not in _RESUMABLE] + (["set"] if arguments.overrides else [])
    if fixed:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in fixed)
        raise ConfigError(f"{names}: a resumed run keeps its settings, --total-frames and --max-minutes excepted")
    state = load_checkpoint(arguments.resume)
    changed = {name: getattr(arguments, name) for name in _RESUMABLE if getattr(arguments, name) is not None}
    return _exit_code(Trainer(make_config({**state["config"], **changed}), arguments.resume, state).train())


def _exit_code(signal: int | None) -> int:
    return 0 if signal is None else 128 + signal


def evaluate(arguments: argparse.Namespace) -> None:
    """``torchrl-atr evaluate``."""
    from functools import partial

    from torchrl_atr.evaluation import command_grid, evaluate_tracking, figures, tracking_metrics, write_report
    from torchrl_atr.training import DEPLOYED, load_run, make_env

    output = _report_folder(arguments)
    deck = _deck(arguments)
    config, env, networks, state = load_run(arguments.run, num_envs=1, **deck)
    env.close()
    result = evaluate_tracking(
        networks.deployed_policy(),
        partial(make_env, config, randomization=arguments.randomization, **deck, **DEPLOYED),
        command_grid(arguments.max_speed, arguments.max_yaw_rate, arguments.speed_step, arguments.yaw_rate_step),
        robots_per_command=arguments.robots_per_command,
        seed=arguments.seed,
        encoder_module=networks.encoder_module,
        progress=_show_steps,
    )
    metrics = tracking_metrics(result)
    metrics["evaluation"] = {
        "transporter": env.base_env.scene.transporter.name,
        "seed": arguments.seed,
        "randomization": arguments.randomization,
    }
    metrics["run"] = state["provenance"]
    write_report(result, metrics, output)
    if (arguments.run / "progress.csv").is_file():
        figures.plot_learning_curves(arguments.run / "progress.csv", output / "learning_curves.png")
    weights = state["curriculum"]["weights"]
    figures.plot_curriculum(weights, env.transform[0].grid.bounds, output / "curriculum.png")
    _print_figures(metrics)
    sys.stdout.write(f"report in {output}\n")


def _deck(arguments: argparse.Namespace) -> dict[str, str]:
    """The env argument that puts the run's robot on another transporter, if one is asked for."""
    return {} if arguments.transporter is None else {"transporter": arguments.transporter}


def _report_folder(arguments: argparse.Namespace) -> Path:
    """Where the report goes: a run's own is of the transporter that it was trained on."""
    from torchrl_atr.training import ConfigError

    output = arguments.output or arguments.run
    if arguments.transporter is not None and output.resolve() == arguments.run.resolve():
        raise ConfigError(
            f"--transporter {arguments.transporter}: the report in {arguments.run} is of the transporter that it was "
            "trained on; give another folder with --output"
        )
    return output


def _show_steps(done: int, total: int) -> None:
    if done % 50 == 0 or done == total:
        sys.stdout.write(f"\revaluating: {done} of {total} control steps" + ("\n" if done == total else ""))
        sys.stdout.flush()


def _print_figures(metrics: dict[str, Any]) -> None:
    """The headline figures, those of a board that stays still beside them."""
    still = metrics["do_nothing"]
    sys.stdout.write(f"{'':32}{'ours':>10}{'do nothing':>14}\n")
    for name in _HEADLINES:
        ours, theirs = (f"{value:.3f}" if value is not None else "-" for value in (metrics[name], still[name]))
        sys.stdout.write(f"{name:32}{ours:>10}{theirs:>14}\n")


def play(arguments: argparse.Namespace) -> None:
    """``torchrl-atr play``."""
    from torchrl_atr.evaluation import play_viewer, record_video
    from torchrl_atr.training import DEPLOYED, load_run

    _, env, networks, _ = load_run(arguments.run, num_envs=1, seed=arguments.seed, **_deck(arguments), **DEPLOYED)
    policy = networks.deployed_policy()
    if arguments.video is None:
        play_viewer(policy, env)
    else:
        record_video(policy, env, arguments.video, seconds=arguments.seconds)
        sys.stdout.write(f"wrote {arguments.video}\n")


def write_model(arguments: argparse.Namespace) -> None:
    """``torchrl-atr model``."""
    from torchrl_atr.envs import Readings, get_robot, get_transporter
    from torchrl_atr.envs.models import scene_spec

    robot = get_robot(arguments.robot)
    spec = scene_spec(robot, get_transporter(arguments.transporter, robot), Readings())
    arguments.output.write_text(spec.to_xml())
    sys.stdout.write(f"wrote {arguments.output}; keyframe 'stand' is the robot standing on its transporter\n")


def bench(arguments: argparse.Namespace) -> None:
    """``torchrl-atr bench``: its code stands beside the package in a clone, outside of what is installed."""
    root = Path(__file__).parents[1]
    if not (root / "benchmarks" / "bench.py").is_file():
        raise UserError("the benchmark is not part of the installed package; run it from a clone, after scripts/setup")
    sys.path.insert(0, str(root))
    from benchmarks.bench import FULL, QUICK, run

    command = "torchrl-atr bench --quick" if arguments.quick else "torchrl-atr bench"
    run(QUICK if arguments.quick else FULL, arguments.output, command)
    sys.stdout.write(f"{(arguments.output / 'bench.md').read_text()}report in {arguments.output}\n")


def _list(arguments: argparse.Namespace) -> None:
    sys.stdout.writelines(f"{line}\n" for line in LISTINGS[arguments.what]())


_COMMANDS: dict[str, Any] = {
    "train": train,
    "evaluate": evaluate,
    "play": play,
    "model": write_model,
    "bench": bench,
    "list": _list,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; bad input ends with one message and exit code 2."""
    arguments = build_parser().parse_args(argv)
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")  # read when torchrl is imported, by the command
    try:
        return _COMMANDS[arguments.command](arguments) or 0
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130
    except (UserError, OSError, ImportError) as error:
        sys.stderr.write(f"torchrl-atr {arguments.command}: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())

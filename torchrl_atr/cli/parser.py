"""What the command line understands, and how it refuses the rest."""

from __future__ import annotations

import argparse
import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

from torchrl_atr import __version__
from torchrl_atr._registry import nearest
from torchrl_atr.listings import LISTINGS

DEFAULT_RUN = Path("runs/latest")
SETTINGS = (
    "task",
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
    "learners",
)
"""Settings that have an option of their own."""
PLACES = ("config", "overrides", "output", "overwrite", "start")
"""What else ``train`` takes."""
RESUMABLE = ("total_frames", "max_minutes", "device", "imports")


def _path(text: str) -> Path:
    if not text.strip():  # of an unset shell variable; Path("") would be the working directory
        raise argparse.ArgumentTypeError("it is empty; give a path")
    return Path(text)


def _run(text: str) -> Path:
    path = _path(text)
    if path.is_file():
        raise argparse.ArgumentTypeError(f"{path} is a file; give the folder of a run, such as {path.parent}")
    return path


def _number(kind: Callable[[str], float], low: float, high: float) -> Callable[[str], float]:
    """A reader of numbers in [low, high] for argparse, which says which option is wrong."""

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            numbers = "whole number" if kind is int else "number"
            raise argparse.ArgumentTypeError(f"{text!r} does not fit; give a {numbers} in [{low:.10g}, {high:.10g}]")
        return value

    return read


_seed = _number(int, 0, 2**31 - 1)


def option(name: str) -> str:
    """What the command line calls a setting."""
    return {"imports": "--import", "overrides": "--set", "start": "--from"}.get(name, f"--{name.replace('_', '-')}")


def build_parser() -> argparse.ArgumentParser:
    """The command line, every command with its help."""
    parser = argparse.ArgumentParser(
        prog="torchrl-atr", description="Quadrupeds that ride personal transporters, walk, and do tasks of your own."
    )
    parser.add_argument("--version", action="version", version=f"torchrl-atr {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    _add_train(commands.add_parser("train", help="train a policy; go on from a run with --resume"))
    _add_evaluate(commands.add_parser("evaluate", help="measure the deployed policy over a grid of commands"))
    _add_play(commands.add_parser("play", help="watch the deployed policy, or film it with --video"))
    replay = commands.add_parser("replay", help="step through a simulation that failed: a file of a run's diverged/")
    replay.add_argument("dump", type=_path)
    _add_import(replay)
    replay.add_argument("--video", type=_path, help="write an .mp4 or .gif, slowed down ten times")
    _add_bench(commands.add_parser("bench", help="measure speed against limits and peers (from a clone)"))
    model = commands.add_parser("model", help="write a robot on its transporter as one MJCF file")
    model.add_argument("robot", help="a name, or a .toml file that describes one of your own")
    model.add_argument("transporter", help="a name, or a .toml file that describes one of your own")
    model.add_argument(
        "--output", type=_path, required=True, metavar="FILE", help="an .xml for python -m mujoco.viewer"
    )
    _add_import(model)
    listing = commands.add_parser("list", help="list what is registered")
    listing.add_argument("what", choices=sorted(LISTINGS))
    _add_import(listing)
    for command in commands.choices.values():
        command.set_defaults(parser=command)
    return parser


def _add_train(parser: argparse.ArgumentParser) -> None:
    # names match TrainConfig's fields, which convert and check; None means "as the config file or the default says"
    parser.add_argument("--task", help="riding (the default), walking, or one of your own")
    parser.add_argument("--robot", help="a name, or a .toml file that describes one of your own")
    parser.add_argument("--transporter", help="of riding: a name, or a .toml file that describes one of your own")
    parser.add_argument("--profile", help="how the paper's open points are read")
    parser.add_argument("--estimator", help="a registered estimator")
    _add_import(parser)
    parser.add_argument("--num-envs", metavar="N")
    parser.add_argument("--total-frames", metavar="N", help="robot steps, absolute")
    parser.add_argument("--max-minutes", metavar="MINUTES", help="wall clock, earlier sessions of the run included")
    parser.add_argument("--seed", metavar="N")
    parser.add_argument("--device", help="cpu or cuda")
    parser.add_argument("--collector", help="where robots are simulated: direct, process, ray or distributed")
    parser.add_argument("--workers", metavar="N", help="processes that share robots and CPUs, unless direct")
    parser.add_argument("--learners", metavar="N", help="processes that share robots and CPUs, and learn together")
    parser.add_argument("--config", type=_path, metavar="FILE", help=".toml or .json with any setting")
    parser.add_argument(
        "--set", dest="overrides", action="append", metavar="KEY=VALUE", help="any setting: `list settings`"
    )
    parser.add_argument("--output", type=_path, metavar="RUN", help=f"the run folder; default: {DEFAULT_RUN}")
    parser.add_argument("--overwrite", action="store_const", const=True, help="replace a run in that folder")
    parser.add_argument("--resume", type=_run, metavar="RUN", help="go on with this run as if it had not stopped")
    begin_text = (
        "begin a new run with this one's networks, optimisers, command grid and settings, those given here excepted"
    )
    parser.add_argument("--from", dest="start", type=_run, metavar="RUN", help=begin_text)


def _add_import(parser: argparse.ArgumentParser) -> None:
    text = "import it first: it may register tasks, robots, transporters and estimators of yours"
    parser.add_argument("--import", dest="imports", action="append", metavar="MODULE", help=text)


def _add_evaluate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=_run)
    _add_checkpoint(parser)
    _add_import(parser)
    parser.add_argument("--seed", type=_seed, default=0)
    parser.add_argument("--output", type=_path, help="where the report goes; default: the run folder")
    parser.add_argument("--robot", help="measure another one than it was trained with; needs --output")
    parser.add_argument("--transporter", help="measure on another one than it was trained on; needs --output")
    parser.add_argument("--randomization", choices=("train", "test", "off"), default="train")
    parser.add_argument(
        "--max-speed", type=_number(float, 0, 100), help="m/s; default: 2, or the task's if that is less"
    )
    parser.add_argument("--max-yaw-rate", type=_number(float, 0, 100), default=1.0, help="rad/s")
    parser.add_argument(
        "--speed-step", type=_number(float, 0.001, 100), help="m/s; divides the range; default: 1, or 0.5"
    )
    parser.add_argument("--yaw-rate-step", type=_number(float, 0.001, 100), default=0.25, help="rad/s; likewise")
    parser.add_argument("--robots-per-command", type=_number(int, 1, 100_000), default=8)
    text = "clip commands to the run's command_range.json, if there is one; or not; or not, and write it anew"
    parser.add_argument("--command-range", choices=("apply", "ignore", "record"), default="apply", help=text)


def _add_play(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=_run)
    _add_checkpoint(parser)
    _add_import(parser)
    parser.add_argument("--robot", help="watch another one than it was trained with")
    parser.add_argument("--transporter", help="ride another one than it was trained on")
    parser.add_argument("--video", type=_path, help="write an .mp4 or .gif instead of opening a viewer")
    parser.add_argument("--seconds", type=_number(float, 0.1, 3600), default=20.0, help="of the video")
    parser.add_argument("--seed", type=_seed, default=0)


def _add_checkpoint(parser: argparse.ArgumentParser) -> None:
    help_text = "the last one of the run, or the one with the largest episode reward"
    parser.add_argument("--checkpoint", choices=("last", "best"), default="last", help=help_text)


def _add_bench(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="tiny sizes: shows that it works, measures nothing")
    parser.add_argument("--output", type=_path, default=Path("results/bench"), metavar="DIR")


def refuse(arguments: argparse.Namespace, text: str) -> None:
    """Exits with code 2 for an argument that the command does not have; a setting may go by ``--set``."""
    name = text.partition("=")[0].lstrip("-")
    options = re.findall(r"--[a-z-]+", arguments.parser.format_usage())
    similar = nearest(name, (option.removeprefix("--") for option in options), otherwise="")  # dashes say nothing
    hint = similar.replace("'", "'--", 1) or f"see torchrl-atr {arguments.command} --help"
    if arguments.command == "train" and f"--{name}" not in options:
        from torchrl_atr.training import TrainConfig

        setting = name.replace("-", "_")
        if setting in (field.name for field in dataclasses.fields(TrainConfig)):
            hint = f"write it as --set {setting}=VALUE"
    arguments.parser.error(f"unknown argument {text!r}; {hint}")

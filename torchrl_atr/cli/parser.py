"""Parser of the command line, and its errors for unknown arguments."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Any

from torchrl_atr import __version__
from torchrl_atr._registry import nearest
from torchrl_atr.cli.compare import add_compare
from torchrl_atr.cli.navigate import add_navigate
from torchrl_atr.cli.option_types import file_path, number_in, run_folder, seed
from torchrl_atr.cli.play import add_play
from torchrl_atr.cli.plot import add_plot
from torchrl_atr.cli.protocols import PROTOCOLS
from torchrl_atr.cli.reproduce import add_reproduce
from torchrl_atr.cli.view import add_demo, add_view
from torchrl_atr.listings import LISTINGS

_PROTOCOL_HELP = (
    "tracking: 10 s of every command of a grid; paper: the same over the paper's commands, ±15 m/s × ±2 rad/s, in the "
    "test range; endurance: minutes of random commands, one after the other, and pushes; robustness: short rides of "
    "that kind, one parameter at a time from training to beyond the test range; compatibility: on the robots and "
    "transporters of its size class"
)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line, every command with its help."""
    parser = argparse.ArgumentParser(
        prog="torchrl-atr", description="Quadrupeds that ride personal transporters, walk, and do custom tasks."
    )
    parser.add_argument("--version", action="version", version=f"torchrl-atr {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("train", help="train a policy; continue a run with --resume", add_help=False)
    _add_evaluate(commands.add_parser("evaluate", help="measure how the deployed policy tracks commands, or lasts"))
    playing = commands.add_parser("play", help="watch the deployed policy, or film it with --video")
    add_play(playing)
    _add_checkpoint(playing)
    _add_import(playing)
    add_demo(commands.add_parser("demo", help="steer a riding robot in the browser"))
    viewing = commands.add_parser("view", help="see, steer and read a policy or a run in the browser")
    add_view(viewing)
    _add_checkpoint(viewing)
    _add_import(viewing)
    _add_bundles(commands)
    navigation = commands.add_parser("navigate", help="follow planned paths over a map, and measure the energy")
    add_navigate(navigation)
    _add_checkpoint(navigation)
    _add_import(navigation)
    comparison = commands.add_parser("compare", help="train and measure other estimators in the policy of a run")
    add_compare(comparison)
    _add_checkpoint(comparison)
    _add_import(comparison)
    paper = commands.add_parser("reproduce", help="make the paper's figures and tables from policies")
    add_reproduce(paper)
    _add_import(paper)
    add_plot(commands.add_parser("plot", help="draw figures over runs, for papers"))
    replay = commands.add_parser("replay", help="step through a simulation that failed: a file of a run's diverged/")
    replay.add_argument("dump", type=file_path)
    _add_import(replay)
    replay.add_argument("--video", type=file_path, help="write an .mp4 or .gif, slowed down ten times")
    _add_bench(commands.add_parser("bench", help="measure speed against limits and peers (from a clone)"))
    model = commands.add_parser("model", help="write a robot on its transporter as one MJCF file")
    model.add_argument("robot", help="a name, or a .toml file that describes a custom one")
    model.add_argument("transporter", help="a name, or a .toml file that describes a custom one")
    model.add_argument(
        "--output", type=file_path, required=True, metavar="FILE", help="an .xml for python -m mujoco.viewer"
    )
    _add_import(model)
    listing = commands.add_parser("list", help="list what is registered")
    listing.add_argument("what", choices=sorted(LISTINGS))
    listing.add_argument("--markdown", action="store_true", help="of settings: the page docs/settings.md")
    _add_import(listing)
    for command in commands.choices.values():
        command.set_defaults(parser=command)
    return parser


def _add_bundles(commands: Any) -> None:
    export = commands.add_parser("export", help="write the deployed policy as a bundle that runs without torch")
    export.add_argument("run", type=run_folder)
    export.add_argument("--output", type=file_path, required=True, metavar="DIR", help="its name becomes the policy's")
    _add_checkpoint(export)
    _add_import(export)
    verify = commands.add_parser("verify", help="check a bundle's files, and that its policy acts as torch did")
    verify.add_argument("bundle", type=run_folder)


def _add_import(parser: argparse.ArgumentParser) -> None:
    text = "import it first: it may register tasks, robots, transporters and estimators of yours"
    parser.add_argument("--import", dest="imports", action="append", metavar="MODULE", help=text)


def _add_evaluate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=run_folder)
    _add_checkpoint(parser)
    _add_import(parser)
    parser.add_argument("--seed", type=seed, default=0)
    parser.add_argument("--protocol", choices=tuple(PROTOCOLS), default="tracking", help=_PROTOCOL_HELP)
    output_text = "where the report goes; default: the run folder, of another protocol than tracking RUN/PROTOCOL"
    parser.add_argument("--output", type=file_path, help=output_text)
    parser.add_argument("--robot", help="measure another one than it was trained with; needs --output")
    parser.add_argument("--transporter", help="measure on another one than it was trained on; needs --output")
    parser.add_argument("--randomization", choices=("train", "test", "off"), help="default: train; of paper: test")
    parser.add_argument(
        "--max-speed", type=number_in(float, 0, 100), help="m/s; default: 2, or the task's if less; of paper: 15"
    )
    parser.add_argument("--max-yaw-rate", type=number_in(float, 0, 100), help="rad/s; default: 1; of paper: 2")
    parser.add_argument("--sensors", metavar="NAME", help="ideal, realistic or a custom set; default: the run's")
    source_text = (
        "estimated: what a robot has; privileged: the truth, to tell errors of estimates from those of control"
    )
    parser.add_argument("--act-source", choices=("estimated", "privileged"), default="estimated", help=source_text)
    text = (
        "apply: clip commands to command_range.json, if the run has one; ignore: do not clip; record: do not clip, and "
        "write the mastered range there"
    )
    parser.add_argument("--command-range", choices=("apply", "ignore", "record"), default="apply", help=text)
    grid = parser.add_argument_group("--protocol tracking and paper")
    step_text = "m/s; divides the range; default: 1, or 0.5; of paper: 0.1"
    grid.add_argument("--speed-step", type=number_in(float, 0.001, 100), help=step_text)
    step_text = "rad/s; likewise; default: 0.25; of paper: 0.1"
    grid.add_argument("--yaw-rate-step", type=number_in(float, 0.001, 100), help=step_text)
    robots_text = "default: 8; of paper: 1"
    grid.add_argument("--robots-per-command", type=number_in(int, 1, 100_000), metavar="N", help=robots_text)
    endurance = parser.add_argument_group("--protocol endurance, robustness and compatibility")
    endurance.add_argument(
        "--robots", type=number_in(int, 1, 100_000), metavar="N", help="of a ride; default: 200, or 100"
    )
    endurance.add_argument("--seconds", type=number_in(float, 1, 86400), help="of a ride; default: 60 or 20")
    endurance.add_argument("--command-seconds", type=number_in(float, 2.02, 86400), help="of a command; default: 5")
    endurance.add_argument("--no-pushes", dest="pushes", action="store_const", const=False, help="leave pushes out")
    text = "of robustness: those to vary, such as payload com_shift[0] action_delay; default: all"
    endurance.add_argument("--parameters", nargs="+", metavar="NAME", help=text)
    text = "of compatibility: what to ride, such as go1/two_board; default: all pairs of the size class"
    endurance.add_argument("--on", nargs="+", metavar="ROBOT/TRANSPORTER", help=text)


def _add_checkpoint(parser: argparse.ArgumentParser) -> None:
    help_text = "the last one of the run, or the one with the largest episode reward"
    parser.add_argument("--checkpoint", choices=("last", "best"), default="last", help=help_text)


def _add_bench(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="tiny sizes: shows that it works, measures nothing")
    parser.add_argument("--output", type=file_path, default=Path("results/bench"), metavar="DIR")


def refuse(arguments: argparse.Namespace, text: str) -> None:
    """Exit with code 2 for an argument that the command does not have."""
    name = text.partition("=")[0].lstrip("-")
    options = re.findall(r"--[a-z-]+", arguments.parser.format_usage())
    similar = nearest(name, (option.removeprefix("--") for option in options), otherwise="")  # dashes look alike
    hint = similar.replace("'", "'--", 1) or f"see torchrl-atr {arguments.command} --help"
    arguments.parser.error(f"unknown argument {text!r}; {hint}")

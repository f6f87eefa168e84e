"""``torchrl-atr play``: the deployed policy in a viewer or a video."""

from __future__ import annotations

import argparse

from torchrl_atr._files import say
from torchrl_atr.cli.chosen import checkpoint_file, other_model
from torchrl_atr.cli.option_types import file_path, number_in, run_folder, seed

VIDEO_SECONDS = 20.0
"""Length of a video of the default commands."""


def add_play(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``play`` to its parser; its ``--checkpoint`` and ``--import`` are everybody's."""
    parser.add_argument("run", type=run_folder)
    parser.add_argument("--robot", help="watch another one than it was trained with")
    parser.add_argument("--transporter", help="ride another one than it was trained on")
    parser.add_argument("--video", type=file_path, help="write an .mp4 or .gif instead of opening a viewer")
    text = "ride the commands of a .csv or .toml file, or figure6, instead of steering; docs/reproduce.md"
    parser.add_argument("--commands", metavar="FILE", help=text)
    text = "of the ride; default: until the window is closed; of a video 20, or as long as the commands last"
    parser.add_argument("--seconds", type=number_in(float, 0.1, 3600), help=text)
    parser.add_argument("--seed", type=seed, default=0)


def play(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr play``."""
    from torchrl_atr.evaluation import play_viewer, record_video
    from torchrl_atr.evaluation.command_file import check_commands, duration, read_commands
    from torchrl_atr.training import DEPLOYMENT_OVERRIDES, commanded_range, load_run

    commands = None if arguments.commands is None else read_commands(arguments.commands)
    chosen = {"num_envs": 1, "seed": arguments.seed, **other_model(arguments), **DEPLOYMENT_OVERRIDES}
    config, env, networks, _ = load_run(arguments.run, checkpoint_file(arguments), arguments.imports or (), **chosen)
    limits = commanded_range(config, networks)
    if commands is not None and limits is not None:
        check_commands(commands, limits)
    seconds = arguments.seconds or (None if commands is None else duration(commands))
    policy = networks.deployed_policy()
    if arguments.video is None:
        play_viewer(policy, env, commands, seconds)
    else:
        record_video(policy, env, arguments.video, commands, seconds or VIDEO_SECONDS)
        say(f"wrote {arguments.video}")

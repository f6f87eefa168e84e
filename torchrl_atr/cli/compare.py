"""``torchrl-atr compare``: estimators in the policy of a run."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
from collections.abc import Sequence
from typing import Any

from torchrl_atr._files import folder_for, say
from torchrl_atr._text import number
from torchrl_atr.cli.chosen import checkpoint_file
from torchrl_atr.cli.option_types import file_path, number_in, run_folder, seed

_SIZES = ("robots", "seconds", "updates", "batch", "seeds")
_RANGES = ("seed", "randomization", "max_speed", "max_yaw_rate")


def add_compare(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``compare`` to its parser."""
    parser.add_argument("run", type=run_folder)
    parser.add_argument("--estimators", nargs="+", metavar="NAME", help="default: all that `list estimators` shows")
    text = "ideal, realistic or a custom set; default: the run's"
    parser.add_argument("--sensors", nargs="+", metavar="NAME", help=text)
    parser.add_argument(
        "--output", type=file_path, required=True, metavar="DIR", help="what it holds is not made again"
    )
    parser.add_argument(
        "--robots",
        type=number_in(int, 2, 100_000),
        metavar="N",
        help="recorded; a quarter, for validation and rides; default: 256",
    )
    parser.add_argument("--seconds", type=number_in(float, 0.1, 86400), help="of the recording and a ride; default: 60")
    parser.add_argument("--updates", type=number_in(int, 1, 10**9), help="of each estimator; default: 1000")
    parser.add_argument("--batch", type=number_in(int, 1, 10**7), help="control steps in an update; default: 1024")
    text = "also train estimators of a window on histories of these lengths, in control steps; default: the run's alone"
    parser.add_argument("--history-lengths", nargs="+", type=number_in(int, 1, 1000), metavar="H", help=text)
    parser.add_argument("--seeds", type=number_in(int, 1, 1000), help="trainings of each estimator; default: 3")
    parser.add_argument("--seed", type=seed, help="of the recording and the first training; default: 0")
    parser.add_argument("--randomization", choices=("train", "test", "off"), help="default: train")
    parser.add_argument("--max-speed", type=number_in(float, 0, 100), help="m/s; default: 2, or the task's if less")
    parser.add_argument("--max-yaw-rate", type=number_in(float, 0, 100), help="rad/s; default: 1")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: shows that it works, measures nothing")


def compare(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr compare``."""
    from torchrl_atr._threads import TorchThreads
    from torchrl_atr.comparison import QUICK, CompareOptions, Study, summarize, write_comparison
    from torchrl_atr.modules import available_estimators
    from torchrl_atr.runs.provenance import machine
    from torchrl_atr.training import load_run

    given = {name: getattr(arguments, name) for name in (*_SIZES, *_RANGES)}
    sizes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    options = CompareOptions(**{**(QUICK if arguments.quick else {}), **sizes})
    config, env, networks, state = load_run(
        arguments.run, checkpoint_file(arguments), arguments.imports or (), num_envs=1
    )
    estimators = arguments.estimators or available_estimators()
    with folder_for(arguments.output) as output, TorchThreads() as threads:
        study = Study(config, env, networks, output, options, announce=say, tick=threads.update)
        figures, several = {}, list(dict.fromkeys(arguments.sensors or [config.task.sensors]))
        for sensors in several:
            study.check_sensors(sensors)
        for sensors in several:
            recording, outcomes = study.run(estimators, sensors, arguments.history_lengths or ())
            figures[sensors] = summarize(networks, recording, outcomes)
        metrics = {
            "command": _command(arguments, estimators, list(figures), sizes),
            "settings": dataclasses.asdict(options),
            "run": state["provenance"],
            **machine(),
            "sensors": figures,
        }
        write_comparison(metrics, output)
    study.close()
    say("\n".join([*_lines(figures), f"report in {output}"]))


def _command(arguments: argparse.Namespace, estimators: Sequence[str], sensors: Sequence[str], sizes: Any) -> str:
    """Return the command that makes the same comparison again."""
    words = ["torchrl-atr", "compare", str(arguments.run), "--estimators", *estimators, "--sensors", *sensors]
    words += [word for name, value in sizes.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    if arguments.history_lengths:
        words += ["--history-lengths", *map(str, arguments.history_lengths)]
    words += [word for module in arguments.imports or () for word in ("--import", module)]
    words += ["--checkpoint", "best"] * (arguments.checkpoint == "best") + ["--quick"] * arguments.quick
    return shlex.join([*words, "--output", str(arguments.output)])


def _lines(sensors: dict[str, Any]) -> list[str]:
    lines = []
    for name, figures in sensors.items():
        lines.append(f"{f'{name} sensors':24}{'error, std':>12}{'latent R²':>12}{'probe R²':>12}{'up at the end':>16}")
        for estimator, row in figures["estimators"].items():
            scored = "error" in row
            values = (
                [row["error"]["value"], row["latent"]["r_squared"]["value"], row["probe"]["mean"]] if scored else []
            )
            cells = "".join(f" {number(value, 11, 3)}" for value in values) or " " * 36
            lines.append(f"{estimator:24}{cells}{row['rides']['survival']:>16.1%}")
    return lines

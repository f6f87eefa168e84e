"""``torchrl-atr reproduce``: the paper's figures and tables, and the page on its claims."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from torchrl_atr._errors import UserError
from torchrl_atr._files import folder_for, say
from torchrl_atr.cli.option_types import file_path, number_in, seed
from torchrl_atr.cli.printing import step_progress

if TYPE_CHECKING:
    from torchrl_atr.reproduction.policies import RiderPolicy
    from torchrl_atr.reproduction.report import Job
    from torchrl_atr.reproduction.tracking import Grid

ROOT = Path("results/paper")
ALL, SUMMARY = "all", "summary"
_SPACE = ("max_speed", "max_yaw_rate")


Make = Callable[["Job", Path], Path]


class Figure(NamedTuple):
    """Figure or table.

    Attributes:
        prepare: checks its own options, given the modules to import, and returns the function that makes it.
        options: of its own.
        needs_policies: whether it is of given policies.
    """

    prepare: Callable[..., Make]
    options: tuple[str, ...] = ()
    needs_policies: bool = True


def _grid(job: Job, options: Mapping[str, Any]) -> Grid:
    """Return the grid of commands that is asked for."""
    from torchrl_atr.reproduction.tracking import grid_of

    return grid_of(job, *(options.get(name) for name in _SPACE))


def _figure4(imports: Sequence[str], compatibility: bool = False, **space: Any) -> Make:
    from torchrl_atr.reproduction.figure4 import figure4

    return lambda job, folder: figure4(job, folder, compatibility=compatibility, grid=_grid(job, space))


def _table5(imports: Sequence[str], history_only: Sequence[str] = (), **space: Any) -> Make:
    from torchrl_atr.reproduction.policies import load_policies
    from torchrl_atr.reproduction.table5 import table5

    policies = load_policies(history_only, imports, "--history-only")
    return lambda job, folder: table5(job, folder, policies, _grid(job, space))


def _figure6(imports: Sequence[str], **options: Any) -> Make:
    from torchrl_atr.evaluation.command_file import read_commands
    from torchrl_atr.reproduction.figure6 import figure6

    if "commands" in options:
        read_commands(options["commands"])
    return partial(figure6, **options)


def _figure5(imports: Sequence[str], walking: Sequence[str] | None = None, **options: Any) -> Make:
    from torchrl_atr.navigation import load_map
    from torchrl_atr.reproduction.figure5 import figure5
    from torchrl_atr.reproduction.policies import installed_policies, load_policies

    for source in options.get("maps", ()):
        load_map(source)
    walkers = (
        installed_policies(imports, "walking") if walking is None else load_policies(walking, imports, "--walking")
    )
    return partial(figure5, walking=walkers, **options)


def _figure7(imports: Sequence[str], config: Path | None = None, **options: Any) -> Make:
    from torchrl_atr.reproduction.figure7 import chosen_variants, figure7
    from torchrl_atr.training import read_config

    chosen_variants(options.get("variants"))
    settings = None if config is None else read_config(config)
    space = {name: options.pop(name, None) for name in _SPACE}
    return lambda job, folder: figure7(job, folder, settings=settings, grid=_grid(job, space), **options)


FIGURES = {
    "figure4": Figure(_figure4, ("compatibility", *_SPACE)),
    "table5": Figure(_table5, ("history_only", *_SPACE)),
    "figure6": Figure(_figure6, ("commands",)),
    "figure5": Figure(_figure5, ("walking", "maps", "starts")),
    "figure7": Figure(_figure7, ("variants", "frames", "seeds", "config", *_SPACE), needs_policies=False),
}
"""Figures and tables by name, in the order of ``all``."""


def add_reproduce(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``reproduce`` to its parser; its ``--import`` is everybody's."""
    parser.add_argument("name", choices=(*FIGURES, SUMMARY, ALL), help="summary: the page on all claims")
    text = "runs, bundles or installed policies, one for each pair; default: all installed ones"
    parser.add_argument("--policies", nargs="+", metavar="[PAIR=]RUN", help=text)
    text = f"default: {ROOT}/NAME, of all {ROOT}; finished measurements in it are not made again"
    parser.add_argument("--output", type=file_path, metavar="DIR", help=text)
    parser.add_argument("--seed", type=seed, default=0)
    parser.add_argument("--quick", action="store_true", help="coarse sizes, minutes: shows that everything works")
    own = parser.add_argument_group("figure4, table5, figure7")
    text = "of another command space, m/s; default: the paper's 15"
    own.add_argument("--max-speed", type=number_in(float, 0.1, 100), help=text)
    own.add_argument("--max-yaw-rate", type=number_in(float, 0.1, 100), help="likewise, rad/s; default: 2")
    own = parser.add_argument_group("figure4")
    text = "let each policy ride with the other robot of its group, too"
    own.add_argument("--compatibility", action="store_const", const=True, help=text)
    own = parser.add_argument_group("table5")
    text = "policies whose estimators read the history alone, to compare"
    own.add_argument("--history-only", nargs="+", metavar="[PAIR=]RUN", help=text)
    own = parser.add_argument_group("figure6")
    own.add_argument("--commands", metavar="FILE", help=".csv or .toml; default: figure6, which is in the package")
    own = parser.add_argument_group("figure5")
    text = "policies of the walking task, to compare; default: all installed ones"
    own.add_argument("--walking", nargs="*", metavar="RUN", help=text)
    own.add_argument("--maps", nargs="+", metavar="MAP", help="names, .toml files or images; default: open streets")
    own.add_argument("--starts", type=number_in(int, 1, 10_000), metavar="N", help="trips on each; default: 50")
    own = parser.add_argument_group("figure7")
    own.add_argument("--variants", nargs="+", metavar="NAME", help="such as full 'no curriculum'; default: all")
    text = "robot steps of each training; default: the recipe's total_frames"
    own.add_argument("--frames", type=number_in(int, 1, 10**15), metavar="N", help=text)
    own.add_argument("--seeds", type=number_in(int, 1, 1000), metavar="N", help="trainings of each; default: 3")
    own.add_argument("--config", type=file_path, metavar="FILE", help="settings of all trainings, as of train --config")


def reproduce(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr reproduce``."""
    from torchrl_atr.reproduction.parts import Parts
    from torchrl_atr.reproduction.report import Job
    from torchrl_atr.reproduction.summary import summary

    several = arguments.name in (ALL, SUMMARY)
    chosen = list(FIGURES) if arguments.name == ALL else [arguments.name] if arguments.name in FIGURES else []
    _check_options(arguments, chosen)
    output = arguments.output or (ROOT if several else ROOT / arguments.name)
    shared = output if several or arguments.output is not None else ROOT
    imports = tuple(arguments.imports or ())
    makers = {name: FIGURES[name].prepare(imports, **_options(arguments, name)) for name in chosen}
    policies = _policies(arguments, chosen)
    command = shlex.join(_words(arguments))
    for name, make in makers.items():
        folder = output / name if several else output
        job = Job(policies, Parts(shared / "parts"), command, arguments.seed, arguments.quick, imports, step_progress)
        try:
            with folder_for(folder):
                say(f"wrote {make(job, folder)}")
        except UserError as error:
            if arguments.name != ALL:
                raise
            say(f"{name} is left out: {error}")
    if several:
        say(f"wrote {summary(output)}")


def _options(arguments: argparse.Namespace, name: str) -> dict[str, Any]:
    """Return the options of a figure's own that are given."""
    own = {option: getattr(arguments, option) for option in FIGURES[name].options}
    return {option: value for option, value in own.items() if value is not None}


def _policies(arguments: argparse.Namespace, chosen: Sequence[str]) -> list[RiderPolicy]:
    from torchrl_atr.reproduction.policies import installed_policies, load_policies

    if not any(FIGURES[name].needs_policies for name in chosen):
        if arguments.policies is not None:
            raise UserError(f"--policies: {arguments.name} is not of given policies; leave it out")
        return []
    imports = tuple(arguments.imports or ())
    if arguments.policies is not None:
        return load_policies(arguments.policies, imports)
    policies = installed_policies(imports)
    if not policies:
        raise UserError("no policy that rides is installed; give --policies RUN")
    return policies


def _check_options(arguments: argparse.Namespace, chosen: list[str]) -> None:
    allowed = {option for name in chosen for option in FIGURES[name].options}
    for figure in FIGURES.values():
        for option in figure.options:
            if option not in allowed and getattr(arguments, option) is not None:
                owners = [each for each, other in FIGURES.items() if option in other.options]
                raise UserError(f"--{option.replace('_', '-')}: only of {' and '.join(owners)}; leave it out")


def _words(arguments: argparse.Namespace) -> Iterator[str]:
    """Yield the words of the command that makes the same again."""
    yield from ("torchrl-atr", "reproduce", arguments.name)
    for name, value in vars(arguments).items():
        if name in ("command", "parser", "name", "output") or value is None or value is False:
            continue
        if name == "imports":
            yield from (word for module in value for word in ("--import", module))
            continue
        yield f"--{name.replace('_', '-')}"
        yield from [] if value is True else map(str, value if isinstance(value, list) else [value])

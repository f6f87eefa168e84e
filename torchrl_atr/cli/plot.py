"""``torchrl-atr plot``: figures over runs, for papers."""

from __future__ import annotations

import argparse

from torchrl_atr._files import folder_for, say
from torchrl_atr._text import split_label
from torchrl_atr.cli.option_types import file_path
from torchrl_atr.deploy.manifest import find_policy, policies


def add_plot(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``plot`` to its parser."""
    text = "folder of a run, a bundle or a report of `evaluate`; those of one label are seeds: a mean and a band"
    parser.add_argument("runs", nargs="+", metavar="[LABEL=]RUN", help=text)
    parser.add_argument("--output", type=file_path, required=True, metavar="DIR", help="where the figures go")
    parser.add_argument("--format", choices=("pdf", "svg", "png"), default="pdf", help="default: pdf")
    text = "columns of progress.csv; default: reward, episode length, falls, errors and command area"
    parser.add_argument("--curves", nargs="+", metavar="COLUMN", help=text)


def plot(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr plot``."""
    from torchrl_atr.evaluation.set_figures import group_runs, plot_sets

    sets = group_runs([_located(text) for text in arguments.runs])
    with folder_for(arguments.output) as folder:
        written = plot_sets(sets, folder, arguments.format, arguments.curves)
    say("\n".join(str(file) for file in written))


def _located(text: str) -> str:
    """Return ``[LABEL=]RUN`` with the folder of an installed policy in place of its name."""
    label, run = split_label(text, policies())
    return f"{label}={find_policy(run)}" if label else str(find_policy(run))

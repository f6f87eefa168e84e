"""``torchrl-atr view`` and ``torchrl-atr demo``: a policy rides in the browser."""

from __future__ import annotations

import argparse
from typing import Any

from torchrl_atr.cli.option_types import number_in, run_folder, seed

_LINGER = 30.0
"""Seconds after the last browser has left until a demo ends: enough to load the page anew."""


def add_view(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``view`` to its parser; its ``--checkpoint`` and ``--import`` are everybody's."""
    _add_common(parser)
    parser.add_argument(
        "--robots", type=number_in(int, 1, 16), default=1, help="with several, each draws its own intrinsic parameters"
    )
    parser.add_argument("--sensors", metavar="NAME", help="ideal, realistic or a custom set; default: the run's")
    parser.add_argument("--seed", type=seed, default=0)


def add_demo(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``demo`` to its parser."""
    _add_common(parser)


def _add_common(parser: argparse.ArgumentParser) -> None:
    text = "name of an installed policy, or the folder of a run or bundle; default: an installed one, or the newest run"
    parser.add_argument("policy", type=run_folder, nargs="?", metavar="POLICY", help=text)
    text = "default: 8080, or the next one that is free; 0: any"
    parser.add_argument("--port", type=number_in(int, 0, 65535), metavar="N", help=text)
    text = "address to listen on; default: 127.0.0.1, which other machines do not reach"
    parser.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help=text)
    parser.add_argument("--no-open", dest="open", action="store_false", help="print the address, open no browser")


def view(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr view``, until it is stopped."""
    from torchrl_atr.viewer.serve import serve

    options = {name: getattr(arguments, name) for name in ("checkpoint", "robots", "sensors", "seed")}
    setup = _setup(arguments, imports=tuple(arguments.imports or ()), **options)
    serve(setup, arguments.host, arguments.port, arguments.open)


def demo(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr demo``, until it is stopped or its last browser has left."""
    from torchrl_atr.viewer.serve import serve

    serve(_setup(arguments), arguments.host, arguments.port, arguments.open, linger=_LINGER)


def _setup(arguments: argparse.Namespace, **options: Any) -> Any:
    from torchrl_atr.viewer import Setup, default_policy

    return Setup(arguments.policy or default_policy(), **options)

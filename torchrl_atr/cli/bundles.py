"""Commands of ``torchrl-atr`` about policy bundles."""

from __future__ import annotations

import argparse
import shlex
from typing import TYPE_CHECKING

from torchrl_atr._files import say
from torchrl_atr.cli.chosen import checkpoint_file

if TYPE_CHECKING:
    from torchrl_atr.deploy import Parity


def export(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr export``."""
    from torchrl_atr.deploy.export import export_run

    parity = export_run(arguments.run, arguments.output, arguments.imports or (), checkpoint_file(arguments))
    output = shlex.quote(str(arguments.output))
    say(f"{_compared(parity)}\nwrote {output}; check it anywhere with: torchrl-atr verify {output}")


def verify(arguments: argparse.Namespace) -> None:
    """Run ``torchrl-atr verify``, which needs no torch."""
    from torchrl_atr.deploy import verify as compared

    say(f"{_compared(compared(arguments.bundle))}\n{arguments.bundle} is whole")


def _compared(parity: Parity) -> str:
    return (
        f"ONNX Runtime acts as torch within {parity.error:.1e} of the action scale ({parity.steps} steps of "
        f"{parity.robots} robots, {parity.resets} resets)"
    )

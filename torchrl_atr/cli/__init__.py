"""``torchrl-atr``: train | evaluate | play | replay | model | bench | list."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from torchrl_atr._errors import UserError
from torchrl_atr._files import explain
from torchrl_atr.cli.commands import COMMANDS
from torchrl_atr.cli.parser import build_parser, refuse

ENVIRONMENT = {
    "RL_LOGGING_LEVEL": "WARNING",
    "GOMP_SPINCOUNT": "20000",  # between two operations torch's threads spin on CPUs that MuJoCo's then lack
}
"""Set unless they are, before a command imports torch and torchrl, which read them."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; bad input ends with one message and exit code 2."""
    arguments, unknown = build_parser().parse_known_args(argv)
    if unknown:
        refuse(arguments, unknown[0])
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    try:
        return COMMANDS[arguments.command](arguments) or 0
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130
    except (UserError, OSError, ImportError) as error:
        message = explain(error) if isinstance(error, OSError) else error
        sys.stderr.write(f"torchrl-atr {arguments.command}: {message}\n")
        return 2

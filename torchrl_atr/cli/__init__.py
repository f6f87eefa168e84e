"""``torchrl-atr``: train | evaluate | play | replay | model | bench | list."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from torchrl_atr._environment import prepare_environment
from torchrl_atr._errors import UserError
from torchrl_atr._files import explain
from torchrl_atr.cli.commands import COMMANDS
from torchrl_atr.cli.parser import build_parser, refuse


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; bad input ends with one message and exit code 2."""
    arguments, unknown = build_parser().parse_known_args(argv)
    if unknown:
        refuse(arguments, unknown[0])
    prepare_environment()
    try:
        return COMMANDS[arguments.command](arguments) or 0
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130
    except (UserError, OSError, ImportError) as error:
        message = explain(error) if isinstance(error, OSError) else error
        sys.stderr.write(f"torchrl-atr {arguments.command}: {message}\n")
        return 2

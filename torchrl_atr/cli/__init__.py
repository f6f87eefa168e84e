"""``torchrl-atr``: train | evaluate | play | demo | view | export | verify | navigate | compare | replay | ..."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence

from torchrl_atr._environment import prepare_environment
from torchrl_atr._errors import UserError
from torchrl_atr._files import explain, flush, prepare_output
from torchrl_atr._interrupt import Interrupt, end_children


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; bad input ends with one message and exit code 2, SIGINT and SIGTERM with 130 and 143.

    Args:
        argv: the command's words; None for those of the process, which then ends when this returns.
    """
    with Interrupt() as interrupt:
        prepare_output()
        try:
            return _run(argv, interrupt)
        except KeyboardInterrupt as stop:
            number = getattr(stop, "signal", signal.SIGINT)
        except Exception:  # caused by the signal in a child process or in a library during import
            if interrupt.signal is None:
                raise
            number = interrupt.signal
        finally:
            flush()
        if argv is None:
            interrupt.mute()
            end_children()
    sys.stderr.write("stopped\n")
    return 128 + number


def _run(argv: Sequence[str] | None, interrupt: Interrupt) -> int:
    from torchrl_atr.cli.commands import COMMANDS  # here, so that signals are handled as early as possible
    from torchrl_atr.cli.parser import build_parser, refuse

    words = sys.argv[1:] if argv is None else list(argv)
    arguments, unknown = build_parser().parse_known_args(words[:1] if words[:1] == ["train"] else words)
    if unknown:
        refuse(arguments, unknown[0])
    prepare_environment()
    try:
        # every setting is an option of train, which tyro parses
        return COMMANDS[arguments.command](words[1:] if arguments.command == "train" else arguments) or 0
    except (UserError, OSError, ImportError) as error:
        if interrupt.signal is not None:
            raise
        message = explain(error) if isinstance(error, OSError) else error
        sys.stderr.write(f"torchrl-atr {arguments.command}: {message}\n")
        return 2

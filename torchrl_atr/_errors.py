"""Errors whose message is written for the user: the command line prints it and exits with code 2."""

from __future__ import annotations

import textwrap


class UserError(Exception):
    """Error in the user's input; the message names it and the remedy."""


class InputError(UserError, ValueError):
    """Error of an argument with an invalid value, where no narrower class says more."""


class MissingPackageError(UserError, ImportError):
    """Error of a package of an optional extra that is not installed.

    Args:
        package: its name.
        extra: of ``torchrl_atr``, which installs it.

    Example:
        >>> print(MissingPackageError("dm_control", "suite"))
        dm_control is not installed; pip install 'torchrl_atr[suite]'
    """

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"{package} is not installed; pip install 'torchrl_atr[{extra}]'")


def first_line(error: BaseException) -> str:
    r"""Return the first line of another library's error, shortened.

    Example:
        >>> first_line(RuntimeError("no such port\nsee the manual")), first_line(KeyboardInterrupt())
        ('no such port', 'KeyboardInterrupt')
    """
    line = (str(error).strip() or type(error).__name__).splitlines()[0]
    return textwrap.shorten(line, 160)

"""Errors whose message is written for the user: the command line prints it and exits with code 2."""

from __future__ import annotations


class UserError(Exception):
    """Something the user gave is wrong; the message names it and says what to do."""


class InputError(UserError, ValueError):
    """An argument with an impossible value, where no narrower error says more."""

"""Registries of named entries with helpful look-up errors, and import of user modules that add to them."""

from __future__ import annotations

import difflib
import importlib
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Generic, TypeVar

from torchrl_atr._errors import InputError, UserError, first_line

if TYPE_CHECKING:  # names of robots are looked up without them
    from tensordict import NestedKey, TensorDictBase
    from torchrl.data import Composite

T = TypeVar("T")


class UnknownNameError(UserError, KeyError, ValueError):
    """Error of an unknown name; the message lists the known ones."""

    def __str__(self) -> str:
        return str(self.args[0])


def unknown(kind: str, name: object, known: Iterable[str], hint: str = "") -> UnknownNameError:
    """Return the error for a name that is not in ``known``.

    Example:
        >>> print(unknown("robot", "A1", ["a1", "go1"]))
        unknown robot 'A1'; did you mean 'a1'? known: a1, go1
    """
    names = list(known)
    guess = nearest(str(name), names, otherwise="")
    listed = f"known: {', '.join(names)}" + (f"; {hint}" if hint else "")
    return UnknownNameError(
        f"unknown {kind} {name!r}; {guess} {listed}" if guess else f"unknown {kind} {name!r}; {listed}"
    )


def nearest(name: str, known: Iterable[str], otherwise: str | None = None) -> str:
    """Return a hint for the unknown ``name``: the most similar of ``known``, else ``otherwise``, else all.

    Example:
        >>> nearest("jionts", ["joints", "feet"])
        "did you mean 'joints'?"
        >>> nearest("wings", ["joints", "feet"])
        'there are joints, feet'
    """
    names = {entry.lower(): entry for entry in known}
    close = difflib.get_close_matches(name.lower(), names, n=1)
    if close:
        return f"did you mean {names[close[0]]!r}?"
    return f"there are {', '.join(names.values()) or 'none'}" if otherwise is None else otherwise


def nearest_entry(key: NestedKey, entries: TensorDictBase | Composite) -> str:
    """Return a hint for the unknown ``key``: the most similar of all entries, else the names at the root.

    Example:
        >>> from tensordict import TensorDict
        >>> nearest_entry("hights", TensorDict(heights=0.0, speeds=0.0))
        "did you mean 'heights'?"
    """
    roots = f"there are {', '.join(entries.keys())}"
    return nearest(str(key), map(str, entries.keys(True, True)), otherwise=roots)


class Registry(Generic[T]):
    """Entries by name, in the order they were registered.

    Args:
        kind: what the entries are, for messages (``"robot"``).
        hint: remedy for an unknown name, for messages.

    Example:
        >>> colours = Registry("colour")
        >>> _ = colours.register("red", 0xFF0000)
        >>> colours.names()
        ('red',)
    """

    def __init__(self, kind: str, hint: str = "") -> None:
        self.kind, self.hint = kind, hint
        self._entries: dict[str, T] = {}

    def register(self, name: str, entry: T) -> T:
        """Add ``entry``; a name can be taken only once.

        Raises:
            InputError: (a ``ValueError``) if ``name`` is taken.
        """
        if name in self._entries:
            raise InputError(f"the {self.kind} {name!r} is registered already; choose another name")
        self._entries[name] = entry
        return entry

    def get(self, name: str) -> T:
        """Return the entry called ``name``.

        Raises:
            UnknownNameError: if there is none; lists the known names.
        """
        if not isinstance(name, str) or name not in self._entries:
            raise unknown(self.kind, name, self._entries, self.hint)
        return self._entries[name]

    def names(self) -> tuple[str, ...]:
        """Return all names, in the order of registration."""
        return tuple(self._entries)

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __contains__(self, name: object) -> bool:
        return name in self._entries


def import_modules(names: Sequence[str], where: str = "run where it can be found, and imports alone") -> None:
    """Import user modules, which register their entries; the working directory counts, as for ``python -m``.

    Args:
        names: of the modules.
        where: what to do about one that cannot be imported, for the message.

    Raises:
        InputError: if one cannot be imported.
    """
    for name in names:
        if name.endswith(".py") or not all(name.split(".")):
            raise InputError(f"cannot import {name!r}; give a module's name, such as my_module for my_module.py")
    if names and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    for name in names:
        try:
            importlib.import_module(name)
        except (ImportError, SyntaxError) as error:
            raise InputError(f"cannot import {name!r} ({first_line(error)}); {where}") from error

"""A named collection whose look-ups explain themselves."""

from __future__ import annotations

from typing import Generic, TypeVar

from torchrl_atr._errors import UserError

T = TypeVar("T")


class UnknownNameError(UserError, KeyError, ValueError):
    """A name that a registry does not hold; the message lists those it does."""

    def __str__(self) -> str:
        return str(self.args[0])


class Registry(Generic[T]):
    """Entries by name, in the order they were registered.

    Args:
        kind: what the entries are, for messages (``"robot"``).

    Example:
        >>> colours = Registry("colour")
        >>> _ = colours.register("red", 0xFF0000)
        >>> colours.names()
        ('red',)
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._entries: dict[str, T] = {}

    def register(self, name: str, entry: T) -> T:
        """Adds ``entry``; a name can be taken only once.

        Raises:
            ValueError: if ``name`` is taken.
        """
        if name in self._entries:
            raise ValueError(f"the {self.kind} {name!r} is registered already; choose another name")
        self._entries[name] = entry
        return entry

    def get(self, name: str) -> T:
        """The entry called ``name``.

        Raises:
            UnknownNameError: if there is none; lists the names there are.
        """
        if name not in self._entries:
            known = ", ".join(self._entries)
            raise UnknownNameError(f"unknown {self.kind} {name!r}; known: {known}")
        return self._entries[name]

    def names(self) -> tuple[str, ...]:
        """All names, in the order of registration."""
        return tuple(self._entries)

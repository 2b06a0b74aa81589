"""Tables of named values that code outside the package may add to."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import TypeVar

from learn2assemble.errors import InputError, UnknownNameError

T = TypeVar("T")
_pending: list[str] = []


def add_plugin(module: str) -> None:
    """Name a module whose ``register()`` adds entries; it is imported only when a name is needed
    that no table holds yet, or when all names are listed."""
    _pending.append(module)


def load_plugins() -> None:
    """Import the plug-ins named so far and let each add its entries."""
    while _pending:
        importlib.import_module(_pending.pop(0)).register()


class Registry(Mapping[str, T]):
    """Named values of one kind.

    Args:
        kind: what the values are, for error messages, e.g. ``"task"``.
        entries: the package's own.
    """

    def __init__(self, kind: str, entries: Mapping[str, T]) -> None:
        self.kind = kind
        self._entries: dict[str, T] = dict(entries)

    def register(self, name: str, value: T, *, replace: bool = False) -> None:
        """Add ``value`` under ``name``.

        Raises:
            InputError: for a name that is taken, unless ``replace`` is given.
        """
        if name in self._entries and not replace:
            raise InputError(f"{self.kind} name", name, "a name that is not taken")
        self._entries[name] = value

    def __getitem__(self, name: str) -> T:
        if name not in self:
            raise UnknownNameError(self.kind, name, self._entries)
        return self._entries[name]

    def __contains__(self, name: object) -> bool:
        if name not in self._entries:
            load_plugins()
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        load_plugins()
        return iter(self._entries)

    def __len__(self) -> int:
        load_plugins()
        return len(self._entries)
